"""Compiled flows: a structure's equations of motion, integrated over given times in
SIMD lanes.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from typing import Any, TypeVar

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics import compile_cache
from gaitsweep.tasks.mechanics.equations import system
from gaitsweep.tasks.mechanics.lumped import Structure

Compiled = TypeVar("Compiled")

#: Taylor steps a flow may take before it counts as lost; a step of a gait takes 5 to
#: 40.
_MAX_STEPS = 120
#: The vectorised sine reduces the arguments of a whole register differently if one of
#: them is larger [rad].
_LARGE_ANGLE = 10.0


def _register() -> int:
    """Numbers in a SIMD register: heyoka recommends half of AVX-512's, with which a
    lane takes half as long again.
    """
    found = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    if any("512" in name or name == "X86_V4" for name in found):
        return 8
    return int(hy.recommended_simd_size())


def _lanes() -> int:
    """Numbers computed at a time: a processor with wide registers can do as one with
    narrower ones; one with narrower ones has no vectorised sine of a wide register,
    whose digits would be others.
    """
    widest = _register()
    asked = os.environ.get("GAITSWEEP_LANES")
    return min(int(asked), widest) if asked else widest


#: Numbers in a SIMD register.
LANES = _lanes()
#: Tolerance of the exact flows: order 18, whose truncation error is a fiftieth of
#: rounding.
_FINE = 1.75e-15
#: Tolerance of an integral along a motion: order 16, the error of what a damper
#: dissipates 2e-15 of it, as a gait's own motion is flown in full.
_INTEGRAL = 1e-13
#: Tolerance of a search's flows, which only give the exact ones their initial guesses.
_COARSE = 1e-7


#: Options of heyoka for compact code, which is compiled in a tenth of the time and takes
#: two to three times as long. More optimisation costs a third more and gains a tenth.
COMPACT: dict[str, Any] = {"compact_mode": True, "opt_level": 1}
_is_compact: ContextVar[bool] = ContextVar("is_compact", default=False)
#: Who is told of a long compilation, if not who listens to the log.
_teller: ContextVar[Callable[[str], object] | None] = ContextVar("teller", default=None)
#: After how many seconds of compilation, in all, who waits is told of it.
_PATIENCE = 1.0
_TOLD = "Compiling the equations of motion, once on this computer."


def is_compact() -> bool:
    """Whether flows are compact now."""
    return _is_compact.get()


@contextlib.contextmanager
def compact_code(tell: Callable[[str], object]) -> Iterator[None]:
    """Let flows be compact, for questions of few points.

    Digits differ from those of full code by rounding, so that whatever is archived is
    computed without.

    Parameters
    ----------
    tell : callable
        Is given a sentence, once in a process, where the compilation takes long.
    """
    token = _is_compact.set(True)
    try:
        with told(tell):
            yield
    finally:
        _is_compact.reset(token)


@contextlib.contextmanager
def told(tell: Callable[[str], object]) -> Iterator[None]:
    """Let a function be given a sentence, once in a process, where compilation takes
    long.
    """
    token = _teller.set(tell)
    try:
        yield
    finally:
        _teller.reset(token)


class _Waiting:
    """Tells who waits, once in a process, that equations are compiled: after a second
    of it in all, so that loading what was compiled before is not told.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.is_told = self.is_counting = False

    @contextlib.contextmanager
    def telling(self, tell: Callable[[str], object] | None) -> Iterator[None]:
        """Count the time that something takes to compile."""
        if tell is None or self.is_told or self.is_counting:
            yield
            return

        self.is_counting = True
        began = time.monotonic()
        delay = max(0.0, _PATIENCE - self.seconds)
        timer = threading.Timer(delay, self._tell, [tell])
        timer.daemon = True
        with contextlib.suppress(RuntimeError):  # there is no memory for a thread
            timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self.is_counting = False
            self.seconds += time.monotonic() - began

    def _tell(self, tell: Callable[[str], object]) -> None:
        self.is_told = True
        tell(_TOLD)


_waiting = _Waiting()


def _listener() -> Callable[[str], object] | None:
    """Who is told that something is compiled; None if nobody listens."""
    logger = logging.getLogger("gaitsweep")
    is_logged = logger.isEnabledFor(logging.INFO)
    return _teller.get() or (logger.info if is_logged else None)


def compiled(
    make: Callable[..., Compiled],
    *given: Any,
    meanwhile: Callable[[], object] = lambda: None,
) -> Compiled:
    """Return what a function compiles, kept on disk between processes; all code that
    heyoka compiles comes this way.

    Parameters
    ----------
    make : callable
        What it returns can be pickled, and depends on its source, that of the equations
        and its arguments alone.
    given
        Its arguments.
    meanwhile : callable
        Called once if another process compiles the same, before waiting for it.
    """
    hy.set_nthreads(1)
    hy.set_logger_level_error()
    hy.llvm_state.set_diskcache_enabled(False)  # which has no checksums
    lanes = f"{LANES} lanes"
    with _waiting.telling(_listener()):
        return compile_cache.kept(make, *given, variant=lanes, meanwhile=meanwhile)


def whole_groups(values: np.ndarray, lanes: int) -> np.ndarray:
    """Repeat the last lane until the lanes fill whole groups.

    Parameters
    ----------
    values : ndarray, shape (..., n)
    lanes : int
        Lanes of a group.

    Returns
    -------
    ndarray, shape (..., a multiple of `lanes`)
        Contiguous; the same array where nothing is missing.
    """
    n = values.shape[-1]
    if not n % lanes:
        return np.ascontiguousarray(values)
    padded = np.empty((*values.shape[:-1], n + -n % lanes))
    padded[..., :n], padded[..., n:] = values, values[..., -1:]
    return padded


class _Batch:
    """Whole groups of lanes to integrate over their durations, and what they come to:
    states at the end, the times reached, and samples of the motion.
    """

    def __init__(
        self,
        state: np.ndarray,
        parameters: np.ndarray,
        duration: np.ndarray,
        samples: int,
        angles: int,
    ):
        self.state, self.parameters, self.duration = state, parameters, duration
        self.fractions = np.empty((0, 1))
        if samples:
            self.fractions = np.linspace(0.0, 1.0, samples + 1)[:, None]
        width = len(duration)
        self.final = np.empty((len(state), width))
        self.reached = np.full(width, np.nan)
        self.motion = np.empty((len(self.fractions), angles, width))

    def lost(self, lanes: slice) -> np.ndarray:
        """Whether motions ended at another time than asked; heyoka's clock may be off
        by its last digit only.
        """
        duration = self.duration[lanes]
        late = np.abs(self.reached[lanes] - duration)
        return np.asarray(~(late <= 1e-15 * np.abs(duration)))


class Flow:
    """A flow over given times, with its variations, for any number of lanes.

    Work is counted in `evaluations` (lanes integrated), `idle` (lanes that fill up a
    group) and `seconds`. Every lane runs the same code with Taylor steps of its own, so
    its bits do not depend on its neighbours; a group with a lane that is lost or turns
    over is integrated again lane by lane to keep that true.
    """

    def __init__(
        self,
        structure: Structure,
        directions: int,
        with_slope: bool,
        coarse: bool,
        dissipates: bool = False,
        compact: bool = False,
        meanwhile: Callable[[], object] = lambda: None,
    ):
        #: What comes after these among a walker's parameters only the strikes need.
        self._used = len(structure.parameters)
        self.angles = 6 if structure.kneed else 4
        # Without a foot mass the links do not couple: with so few terms a group of two
        # narrow registers is faster.
        self.lanes = max(LANES, 8) if ("eps", 0.0) in structure.units else LANES
        self.evaluations = self.idle = 0
        self.seconds = 0.0

        exact = _INTEGRAL if dissipates else _FINE
        self._ta, self._parameters = compiled(
            _compiled_flow,
            structure,
            self.lanes,
            directions,
            with_slope,
            dissipates,
            _COARSE if coarse else exact,
            COMPACT if compact else {},
            meanwhile=meanwhile,
        )
        # Views of the integrator's own memory.
        self._state, self._pars = self._ta.state, self._ta.pars
        self._time = self._ta.time

    def __call__(
        self,
        state: np.ndarray,
        parameters: np.ndarray,
        duration: np.ndarray,
        samples: int = 0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Integrate every lane over its own duration.

        Parameters
        ----------
        state : ndarray, shape (size, n)
            Initial scaled state and variations.
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.
        duration : ndarray, shape (n,) [sqrt(leg/g)]
        samples : int
            Number of equal intervals at whose ends the motion is also returned.

        Returns
        -------
        final : ndarray, shape (size, n)
            NaN in lanes whose motion was lost.
        motion : ndarray, shape (samples + 1, angles, n)
            Angles and rates; of no samples where none are asked for.
        """
        began, n = time.process_time(), state.shape[1]
        batch = _Batch(
            whole_groups(state, self.lanes),
            self._parameters(whole_groups(parameters[: self._used], self.lanes)),
            whole_groups(duration, self.lanes),
            samples,
            self.angles,
        )
        width = len(batch.duration)
        for first in range(0, width, self.lanes):
            group = slice(first, first + self.lanes)
            self._integrate(batch, group, group)

        lost = batch.lost(slice(None))
        angles = np.abs(batch.final[: self.angles // 2, :n])
        lost[:n] |= (angles * parameters[1]).max(axis=0) > _LARGE_ANGLE
        self._integrate_alone(batch, lost)
        self.evaluations += n
        self.idle += width - n
        self.seconds += time.process_time() - began
        return batch.final[:, :n], batch.motion[:, :, :n]

    def _integrate_alone(self, batch: _Batch, lost: np.ndarray) -> None:
        """Integrate groups with a lane that is lost again, lane by lane."""
        groups = np.arange(len(lost)).reshape(-1, self.lanes)
        for lane in groups[lost[groups].any(axis=1)].ravel().tolist():
            alone = slice(lane, lane + 1)
            batch.reached[lane] = np.nan
            self._integrate(batch, [lane] * self.lanes, alone)
            if batch.lost(alone)[0]:
                batch.final[:, lane] = batch.motion[:, :, lane] = np.nan

    def _integrate(self, batch: _Batch, lanes: slice | list[int], to: slice) -> None:
        """Integrate a group of lanes and store the first of them as lanes `to`."""
        # heyoka keeps no place for the last parameters where no term needs them: a
        # balanced leg feels no gravity.
        self._state[:] = batch.state[:, lanes]
        self._pars[:] = batch.parameters[: len(self._pars), lanes]
        try:
            motion = self._advance(batch.duration[lanes], batch.fractions)
        except ValueError:
            # heyoka refuses durations that are not finite.
            return

        kept = slice(to.stop - to.start)
        batch.final[:, to] = self._state[:, kept]
        batch.reached[to] = self._time[kept]
        batch.motion[:, :, to] = motion[:, : self.angles, kept]

    def _advance(self, duration: np.ndarray, fractions: np.ndarray) -> np.ndarray:
        """Integrate a group by heyoka over its whole duration, or to fractions of it;
        the states there.
        """
        self._ta.set_time(0.0)
        if not len(fractions):
            self._ta.propagate_until(duration, max_steps=_MAX_STEPS)
            return np.empty((0, *self._state.shape))

        times = fractions * duration
        motion: np.ndarray = self._ta.propagate_grid(times, max_steps=_MAX_STEPS)[1]
        return motion


#: Every flow compiled by this process, by its structure and options; their counters
#: hold the work done.
FLOWS: dict[tuple[Any, ...], Flow] = {}


def flow(
    structure: Structure,
    directions: int,
    with_slope: bool,
    coarse: bool = False,
    dissipates: bool = False,
) -> Flow:
    """Return the compiled flow of a structure, one a process; the compiled code is kept
    on disk between processes.

    Parameters
    ----------
    structure : Structure
        That of straight legs, or of knees while the swing knee is free; once locked
        they move as straight legs.
    directions : int
        Number of variations carried along.
    with_slope : bool
        True where the last of them is the derivative by the slope.
    coarse : bool
        Integrate to the search's tolerance only.
    dissipates : bool
        Whether the last number of a state is what a damper of unit damping between the
        thighs dissipates, in scaled rates.
    """
    compact = is_compact()
    structure = structure.between_strikes()
    key = structure, directions, with_slope, coarse, dissipates, compact
    if key not in FLOWS:
        # Who follows branches needs both flows of full code: two workers compile one
        # each.
        other = (structure, directions + 1, True)
        is_single = compact or with_slope or coarse or dissipates
        meanwhile = (lambda: None) if is_single else (lambda: flow(*other))
        FLOWS[key] = Flow(*key, meanwhile)

    return FLOWS[key]


def _compiled_flow(
    structure: Structure,
    lanes: int,
    directions: int,
    with_slope: bool,
    dissipates: bool,
    tolerance: float,
    options: dict[str, Any],
) -> tuple[Any, Any]:
    """Compile a flow's integrator, and the function from a walker's parameters to its
    own.
    """
    motion = system(structure, structure.kneed, directions, with_slope, dissipates)
    integrator = hy.taylor_adaptive_batch(
        motion.equations,
        state=np.zeros((len(motion.equations), lanes)),
        tol=tolerance,
        **options,
    )
    return integrator, motion.parameters(batch_size=LANES)


class CompiledFunction:
    """A compiled function of lanes, and the time `seconds` that this process has spent in
    all of them: not the processor time, which the kernel takes longer to tell than many
    calls take.
    """

    seconds = 0.0

    def __init__(self, outputs: list[Any], variables: list[Any]):
        self._function = hy.cfunc(
            outputs, vars=variables, compact_mode=False, batch_size=LANES
        )

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Values of the function, shape (outputs, n), at inputs of shape (variables,
        n).
        """
        began = time.perf_counter()
        values: np.ndarray = self._function(inputs)
        CompiledFunction.seconds += time.perf_counter() - began
        return values

    def iterate(self, inputs: np.ndarray, states: np.ndarray) -> None:
        """Set each of several states (k, outputs, n) but the first to the function's
        values at the one before it, which takes the first places of the inputs.
        """
        began = time.perf_counter()
        first = inputs[: states.shape[1]]
        for before, after in itertools.pairwise(states):
            first[:] = before
            self._function(inputs, outputs=after)
        CompiledFunction.seconds += time.perf_counter() - began


def integrating_seconds() -> float:
    """Time that this process has spent in compiled flows and functions [s]."""
    return sum(flow.seconds for flow in FLOWS.values()) + CompiledFunction.seconds
