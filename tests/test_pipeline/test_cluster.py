"""The same graph on a Dask cluster: equal bytes, nobody blamed for a node that is lost."""

import fcntl
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from conftest import ROOT, STUDY, TOYS
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine import cluster as cluster_executor
from gaitsweep.pipeline.engine.cluster import connect
from gaitsweep.pipeline.errors import StudyError, WorkerError
from processes import alive, descendants, ignored, wait_for_points

pytest.importorskip("distributed")

SLOW = {"TOY_SECONDS": "0.004"}


class Cluster:
    """A scheduler and workers as processes of their own."""

    def __init__(self, folder):
        self.folder = folder
        self.environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{TOYS}"}
        self.file = folder / "scheduler.json"
        self.scheduler = self._start(
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            self.file,
        )
        end = time.monotonic() + 30
        # It is there before anything is written.
        while not (self.file.exists() and self.file.read_text()):
            assert time.monotonic() < end
            time.sleep(0.05)
        self.address = json.loads(self.file.read_text())["address"]
        self.workers = []

    def _start(self, module, *arguments):
        quiet = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
        return subprocess.Popen(
            [sys.executable, "-m", module, *map(str, arguments)],
            env=self.environment,
            cwd=self.folder,
            **quiet,
        )

    def add_worker(self, **environment):
        self.environment |= environment
        self.workers.append(
            self._start(
                "distributed.cli.dask_worker",
                self.address,
                "--host",
                "127.0.0.1",
                "--nthreads",
                "1",
                "--no-nanny",
                "--no-dashboard",
                "--death-timeout",
                "30",
            )
        )

    def close(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path):
    found = Cluster(tmp_path)
    yield found
    found.close()


def test_a_cluster_gives_the_same_bytes(toy, whole, cluster):
    cluster.add_worker()
    cluster.add_worker()
    toy("run", "toy.toml", "--cluster", cluster.address, "--chunk", 50)
    assert toy.bytes() == whole
    (state,) = json.loads(toy("status", "--json").stdout)
    assert 1 <= len(state["workers"]) <= 2 and all(
        w["memory"] > 1 << 24 for w in state["workers"]
    )


@pytest.mark.parametrize(
    "signum", [signal.SIGHUP, pytest.param(signal.SIGINT, marks=pytest.mark.soak)]
)
def test_a_signal_ignored_from_the_start_stays_ignored_on_a_cluster(toy, whole, signum):
    """Whoever logs out ends neither the run nor the dask workers that are in its group."""
    with ignored(signum):
        process = toy.start(
            "run", "toy.toml", "--cluster", "local:2", "--chunk", 20, **SLOW
        )
    wait_for_points(toy, 2)
    group = [
        pid
        for pid in (process.pid, *descendants(process.pid))
        if os.getpgid(pid) == os.getpgid(process.pid)
    ]
    for pid in group:
        os.kill(pid, signum)
    _, err = process.communicate(timeout=100)
    assert process.returncode == 0, err
    assert toy.bytes() == whole


def test_a_study_that_is_refused_does_not_end_a_list_on_a_cluster(toy):
    folder = toy.folder / "data" / "archive"
    busy = Companions(folder / "busy.nc")
    busy.folder.mkdir(parents=True)
    for name in ("busy", "z"):
        toy.write(
            STUDY.replace('"toy"', f'"{name}"').replace("n = 200", "n = 20"),
            f"{name}.toml",
        )
    with busy.lock.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        said = toy(
            "run", "busy.toml", "z.toml", "--cluster", "local:2", expect=5
        ).stderr
    assert (
        ": converged 40; not run to the end: busy.toml" in said
        and (folder / "z.nc").exists()
    )


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("tcp://127.0.0.1", "must be tcp://HOST:PORT or local:N"),
        ("tcp://127.0.0.1:", "must be tcp://HOST:PORT or local:N"),
        ("tcp://127.0.0.1:dask", "must be tcp://HOST:PORT or local:N"),
        ("tcp://127.0.0.1:9/status", "must be tcp://HOST:PORT or local:N"),
        ("tls://127.0.0.1:9", "needs certificates"),
    ],
)
def test_an_address_that_cannot_be_is_refused_at_once(address, said):
    with pytest.raises(StudyError, match=said), connect(address):
        pass


def test_a_script_needs_no_guard_to_run_on_workers_of_its_own(tmp_path):
    """They are in its process: none imports the script again."""
    study = '{"name": "s", "walker": "D", "axes": {"slope": [0.01]}}'
    script = tmp_path / "script.py"
    script.write_text(
        f"from gaitsweep import run\nprint(run({study}, cluster='local:1', quiet=True).status.values[0, 0])\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        [sys.executable, script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert (ended.stdout, ended.stderr) == ("converged\n", "")


def test_certificates_of_clients_are_looked_for(monkeypatch):
    from distributed.security import Security

    for context in (None, "of ssl"):
        monkeypatch.setattr(
            Security,
            "get_connection_args",
            lambda self, role, context=context: {"ssl_context": context},
        )
        assert cluster_executor._has_certificates() == (context is not None)


def test_a_worker_of_other_code_is_refused(toy, cluster, tmp_path):
    """Its numbers would be archived as those of the code of the run."""
    shutil.copytree(
        ROOT / "gaitsweep",
        tmp_path / "other/gaitsweep",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    with (tmp_path / "other/gaitsweep/tasks/measures/gaits.py").open("a") as file:
        file.write("_FURTHER = 1\n")
    cluster.add_worker(PYTHONPATH=f"{tmp_path / 'other'}{os.pathsep}{TOYS}")
    said = toy(
        "run", "toy.toml", "--quiet", "--cluster", cluster.address, expect=3
    ).stderr
    assert (
        said.count("\n") == 1
        and "has code of `tasks` " in said
        and "; the run has " in said
    )


@pytest.mark.filterwarnings(
    "ignore:Couldn't detect a suitable IP address"
)  # there may be no network
def test_a_cluster_that_shrinks_loses_no_job(monkeypatch):
    """Of eight workers one is left: what was submitted is more than it should have
    waiting.
    """
    monkeypatch.setattr(cluster_executor, "RECOUNT", 0.0)
    submitted, found, end = {}, {}, time.monotonic() + 60

    with connect("local:1") as client:
        one = client.nthreads()
        counts = iter([dict.fromkeys(one, 8)])
        monkeypatch.setattr(client, "nthreads", lambda: next(counts, one))
        place = cluster_executor.Cluster(
            cluster_executor.Team(client), run=lambda software, request: -request
        )
        while len(found) < 40 and time.monotonic() < end:
            while len(submitted) < 40 and place.has_room():
                number = len(submitted)
                submitted[place.submit(number)] = number
            found.update(place.completed(0.1))

    assert {ticket: -answer for ticket, answer in found.items()} == submitted


@pytest.mark.filterwarnings("ignore:Couldn't detect a suitable IP address")
def test_a_run_without_workers_ends_after_a_time_that_it_has_told(monkeypatch):
    """The scheduler knows of none, or does not answer."""
    monkeypatch.setattr(cluster_executor, "RECOUNT", 0.1)
    monkeypatch.setattr(cluster_executor, "PATIENCE", 0.5)
    told = []

    with connect("local:1") as client:
        monkeypatch.setattr(client, "nthreads", dict)
        place = cluster_executor.Cluster(
            cluster_executor.Team(client), told.append, lambda software, _: None
        )
        with pytest.raises(
            WorkerError, match=r"The cluster has had no worker for 0.5 s\."
        ) as ended:
            while True:
                place.has_room()
                time.sleep(0.05)

    assert (
        told == ["The cluster has no worker; the run waits 0.5 s for one."]
        and ended.value.exit_code == 3
    )


@pytest.mark.parametrize(
    ("signum", "code", "trouble"),
    [(signal.SIGTERM, 143, signal.SIGKILL), (signal.SIGINT, 130, signal.SIGSTOP)],
    ids=["gone", "stopped"],
)
def test_a_signal_ends_a_run_whose_only_worker_is_lost(
    toy, cluster, signum, code, trouble
):
    cluster.add_worker(**SLOW)
    process = toy.start("run", "toy.toml", "--cluster", cluster.address, "--chunk", 10)
    wait_for_points(toy, 1)
    cluster.workers[0].send_signal(trouble)
    time.sleep(0.5)

    process.send_signal(signum)
    _, err = process.communicate(timeout=20)

    assert process.returncode == code, err
    assert err.splitlines()[-1].startswith(f"gaitsweep: Stopped by {signum.name}")


def test_a_worker_that_cannot_load_gaitsweep_ends_the_run(toy, cluster, tmp_path):
    """At its first job it would end without a word, and the run wait for another."""
    (tmp_path / "other/gaitsweep").mkdir(parents=True)
    (tmp_path / "other/gaitsweep/__init__.py").write_text(
        "raise ImportError('nothing here')\n"
    )
    cluster.add_worker(PYTHONPATH=str(tmp_path / "other"))

    said = toy(
        "run", "toy.toml", "--quiet", "--cluster", cluster.address, expect=3
    ).stderr

    assert (
        said.count("\n") == 1
        and " cannot load gaitsweep: " in said
        and "nothing here" in said
    )


def _listening(pid):
    """Sockets of a process that others can connect to over the network."""
    listens = "0A"
    rows = [
        row.split()
        for name in ("tcp", "tcp6")
        for row in Path(f"/proc/{pid}/net/{name}").read_text().splitlines()
    ]
    there = {f"socket:[{row[9]}]" for row in rows if row[3] == listens}
    files = [
        os.readlink(file)
        for file in Path(f"/proc/{pid}/fd").iterdir()
        if file.is_symlink()
    ]
    return there.intersection(files)


def test_workers_of_its_own_open_no_port(toy, whole):
    """Whoever reached one, the dashboard's too, could run code as the user of the run."""
    process = toy.start(
        "run", "toy.toml", "--cluster", "local:2", "--chunk", 10, **SLOW
    )
    wait_for_points(toy, 2)

    ports = [
        port
        for pid in (process.pid, *descendants(process.pid))
        for port in _listening(pid)
    ]
    process.communicate(timeout=60)

    assert not ports and process.returncode == 0
    assert toy.bytes() == whole


@pytest.mark.soak
def test_no_cluster_is_exit_3(toy):
    done = toy("run", "toy.toml", "--cluster", "tcp://127.0.0.1:9", expect=3)
    assert done.stderr.count("\n") == 1
    assert "No cluster with a worker answers at tcp://127.0.0.1:9." in done.stderr


@pytest.mark.soak
@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize("chunk", [7, 64, 1000, 1])
def test_a_local_cluster_gives_the_same_bytes(toy, whole, tell, workers, chunk):
    toy("run", "toy.toml", "--cluster", f"local:{workers}", "--chunk", chunk)
    assert toy.bytes() == whole
    tell(f"cluster, local:{workers}, --chunk {chunk}: equal bytes")


@pytest.mark.soak
def test_a_bad_point_on_a_cluster_costs_one_point(toy, cluster, tell):
    cluster.add_worker(TOY_TROUBLE="segfault@0.2")
    done = toy("run", "toy.toml", "--cluster", cluster.address, "--chunk", 50, expect=1)
    assert "converged 398, worker_died 2" in done.stderr
    tell(
        "a point that segfaults on a cluster, on two lines: worker_died 2, converged 398"
    )


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(4))
def test_workers_killed_at_random_blame_nobody(toy, whole, cluster, tell, seed):
    dice = random.Random(seed)
    cluster.add_worker(**SLOW)
    cluster.add_worker()
    process = toy.start("run", "toy.toml", "--cluster", cluster.address, "--chunk", 10)
    killed = 0
    for _ in range(4):
        time.sleep(dice.uniform(0.3, 1.5))
        if process.poll() is None:
            victim = dice.choice(
                [worker for worker in cluster.workers if worker.poll() is None]
            )
            victim.send_signal(signal.SIGKILL)
            victim.wait()
            killed += 1
            cluster.add_worker()
    process.communicate(timeout=120)
    assert process.returncode == 0
    assert toy.bytes() == whole
    tell(f"{killed} dask workers killed during a run: nobody blamed, equal bytes")


@pytest.mark.soak
def test_a_cluster_that_loses_all_its_workers_goes_on_with_new_ones(
    toy, whole, cluster, tell
):
    cluster.add_worker(**SLOW)
    cluster.add_worker()
    process = toy.start("run", "toy.toml", "--cluster", cluster.address, "--chunk", 10)
    for _ in range(3):
        wait_for_points(toy, 1)
        time.sleep(0.3)
        for worker in cluster.workers:
            worker.kill()
            worker.wait()
        assert process.poll() is None
        time.sleep(3)  # longer than a count of the workers
        assert process.poll() is None
        cluster.workers = []
        cluster.add_worker()
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert toy.bytes() == whole
    tell(
        "all workers of a cluster killed three times, and others added 3 s later: equal bytes"
    )


@pytest.mark.soak
def test_few_file_handles_on_a_cluster_are_said_in_one_line(toy):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (18, 18))"
    program = f"{limit}\nimport runpy, sys\nsys.argv = sys.argv[1:]\nrunpy.run_path(sys.argv[0], run_name='__main__')"
    words = [
        str(TOYS / "gaitsweep_toy.py"),
        "run",
        "toy.toml",
        "--quiet",
        "--cluster",
        "local:2",
    ]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program, *words],
        cwd=toy.folder,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{TOYS}"},
        capture_output=True,
        text=True,
    )
    assert (
        done.returncode == 3
        and done.stderr.count("\n") == 1
        and "Too many open files" in done.stderr
    ), done.stderr


@pytest.mark.soak
def test_a_killed_scheduler_is_exit_3_and_the_run_resumes(toy, whole, cluster, tell):
    cluster.add_worker(**SLOW)
    process = toy.start(
        "run", "toy.toml", "--cluster", cluster.address, "--chunk", 10, **SLOW
    )
    time.sleep(3)
    cluster.scheduler.kill()
    _, err = process.communicate(timeout=200)
    assert process.returncode == 3 and "Traceback" not in err
    toy("run", "toy.toml")
    assert toy.bytes() == whole
    tell("the scheduler killed during a run: exit 3; run again without it: equal bytes")


@pytest.mark.soak
@pytest.mark.parametrize("signum", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("local", [True, False])
def test_a_stopped_run_leaves_no_process_on_a_cluster(
    toy, whole, cluster, tell, local, signum
):
    """On a cluster of someone else's its workers stay, but not what they started."""
    cluster.add_worker(**SLOW)
    process = toy.start(
        "run",
        "toy.toml",
        "--cluster",
        "local:2" if local else cluster.address,
        "--chunk",
        10,
        **SLOW,
    )
    wait_for_points(toy, 2)
    ours = descendants(process.pid if local else cluster.workers[0].pid)
    assert len(ours) >= 1
    process.send_signal(signum)
    process.communicate(timeout=30)
    assert not alive(ours, 3.0)
    toy("run", "toy.toml")
    assert toy.bytes() == whole
    tell(
        f"{signum.name} to a run on {'a cluster of its own' if local else 'a running scheduler'}: none of {len(ours)}"
        " processes left after 3 s"
    )


@pytest.mark.soak
def test_what_a_chunk_costs_on_a_cluster(toy, tell):
    """Nothing is to be computed: what is left is the way there and back."""
    toy.write(STUDY.replace("n = 200", "n = 10_000"))
    took = {}
    for engine in ("--jobs", "--cluster"):
        toy(
            "run",
            "toy.toml",
            engine,
            "local:2" if engine == "--cluster" else 2,
            "--fresh",
        )
        events = [
            json.loads(e)
            for e in Companions(toy.folder / "data/archive/toy.nc")
            .events.read_text()
            .splitlines()
        ]
        times = [e["time"] for e in events if e["event"] == "chunk"][-700:]
        assert len(times) == 700
        took[engine] = (times[-1] - times[0]) / (len(times) - 1)
    assert max(took.values()) < 0.05
    tell(
        f"a chunk costs {1e3 * took['--jobs']:.1f} ms here, {1e3 * took['--cluster']:.1f} ms on two dask workers,"
        " its place in the journal included"
    )


@pytest.mark.parametrize(
    "wrong",
    [
        'walker = "E"\n[axes]\nslope = [0.01]\nfoot_mass_ratio = [0.1]\nm_h = [1.0]\n',
        'walker = "D"\nkind = "curve"\n[axes]\nslope = [0.01, 0.1]\n[options]\nkey = "R"\nfrom = 0.0\nto = 0.3\n',
    ],
)
def test_a_wrong_study_is_refused_before_a_cluster_is_asked(toy, wrong):
    """The same line with workers of our own and with a scheduler that is not there."""
    toy.write(f'name = "wrong"\n{wrong}', "wrong.toml")
    said = [
        toy("run", "wrong.toml", *where, expect=2).stderr
        for where in ((), ("--cluster", "tcp://127.0.0.1:9"))
    ]
    assert (
        said[0] == said[1] and said[0].count("\n") == 1 and "(wrong.toml, " in said[0]
    )
    assert not (toy.folder / "data").exists()
