// The flight of a walker: equations of motion, impacts and measures of one step, for two links and for three.
//
// Frame and angles are those of docs/physics.md. Units are the leg l + R, the walker's mass and g. Every point of the
// walker is  x + iy = -R q0 + iR + sum of arms A_j e^{i q_j}  over stance shank, stance thigh, swing thigh, swing shank;
// a complex number is a pair [re, im]. A state is the list of angles, then of their rates, of the links that move by
// themselves: stance leg and swing leg, or stance leg, swing thigh and swing shank while the knee is free.

const { isFinite } = Number, { abs, ceil, cos, exp, floor, hypot, log, max, min, sin } = Math;
const MAX_ANGLE = exp(0.5), MAX_TIME = 12, TIME_STEP = 1 / 32;
const FALLS = { backward: "fell backward", forward: "fell forward", knee: "the knee never struck", foot: "the foot never struck", lost: "the motion was lost" };
const VIOLATIONS = ["foot scuffs mid-swing", "stance knee unlocks", "contact tension", "friction", "release hyperextends", "release penetrates", "trailing foot pulls", "trailing knee unlocks", "push-off slips", "takes off"];

const vector = (values, change) => Float64Array.from(values, change);
const plus = (a, b) => [a[0] + b[0], a[1] + b[1]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1]];
const multiply = (a, b) => [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]];
const conjugate = a => [a[0], -a[1]];
const turned = (a, angle) => multiply(a, [cos(angle), sin(angle)]);
// Where a slope stands among others: its logarithm; level ground and uphill come before all that lead down.
const rank = slope => slope > 0 ? log(slope) : 99 * slope - 99;
// Whether a walker may have gaits on a slope: level ground and uphill take something that drives it.
const leads = (keys, slope) => slope > 0 || (isFinite(slope) && (keys.push_off || keys.hip_torque));
const sum = values => values.reduce((total, value) => total + value, 0);
const dot = (a, b) => sum(Array.from(a, (v, i) => v * b[i]));

// Links that move as one, by their places in the chain.
const GROUPS = { open: [[0], [1], [2], [3]], free: [[0, 1], [2], [3]], locked: [[0, 1], [2, 3]] };

/** A walker from its table of keys: geometry, and the constants of its chain of links, each group moving as one. */
function makeWalker(keys) {
  const shank = keys.l_s - keys.R, sine = keys.eps_T ? keys.l_t * sin(keys.eps_T) / shank : 0;
  const epsS = Math.asin(sine), l = keys.l_t * cos(keys.eps_T) + shank * cos(epsS), leg = l + keys.R;
  const mass = 2 * (keys.m_t + keys.m_s) + keys.m_h, inLegs = v => [v[0] / leg, v[1] / leg];
  const knee = inLegs([-keys.l_t * sin(keys.eps_T), -keys.l_t * cos(keys.eps_T)]);
  const thighCentre = inLegs(turned([-keys.w_t, -keys.c_t], -keys.eps_T));
  const shankCentre = inLegs(turned([-keys.w_s, -keys.c_s], epsS));
  const foot = minus([0, -l / leg], knee), none = [0, 0], back = v => [-v[0], -v[1]];
  const arms = [
    [minus(shankCentre, foot), none, none, none],
    [back(foot), minus(thighCentre, knee), none, none],
    [back(foot), back(knee), none, none],
    [back(foot), back(knee), thighCentre, none],
    [back(foot), back(knee), knee, shankCentre],
  ];
  const mt = keys.m_t / mass, ms = keys.m_s / mass, masses = [ms, mt, keys.m_h / mass, mt, ms];
  const size = v => v[0] * v[0] + v[1] * v[1];
  const massless = keys.m_s === 0 && keys.m_t * (keys.r_t ** 2 + size(thighCentre)) === 0;
  const pointFoot = !keys.R && !keys.eps_T && !keys.knees && keys.c_s === keys.l_s && !keys.w_s && !keys.r_s
    && (keys.m_t === 0 || !(keys.c_t || keys.w_t || keys.r_t));
  const inertia = [ms * (keys.r_s / leg) ** 2, mt * (keys.r_t / leg) ** 2];
  const rotation = [inertia[0], inertia[1], inertia[1], inertia[0]];
  const moment = j => arms.reduce((total, row, k) => plus(total, [masses[k] * row[j][0], masses[k] * row[j][1]]), none);
  const S = [0, 1, 2, 3].map(moment), rows = S.map((s, j) => massless && j > 1 ? arms[4][j] : s);
  // Rows of a massless swing leg are divided by its mass: those of a shank of unit mass.
  const K = S.map((_, i) => S.map((_, j) => {
    if (massless && i > 1) return plus(multiply(conjugate(arms[4][i]), arms[4][j]), [i === 3 && j === 3 ? (keys.r_s / leg) ** 2 : 0, 0]);
    return arms.reduce((total, row, k) => {
      const product = multiply(conjugate(row[i]), row[j]);
      return plus(total, [masses[k] * product[0], masses[k] * product[1]]);
    }, [i === j ? rotation[i] : 0, 0]);
  }));
  // What acts between the thighs: of massless legs over their inertia, which is that of K.
  const weight = massless ? 1 / sum([2, 3].flatMap(i => [2, 3].map(j => K[i][j][0]))) : mass * keys.g * leg;
  const rateUnit = massless ? weight : weight * Math.sqrt(leg / keys.g), own = name => keys[name] ?? 0;
  const hip = [own("hip_stiffness") / weight, own("hip_damping") / rateUnit, (own("hip_stiffness") * own("hip_rest") + own("hip_torque")) / weight];
  const placeOf = (groups, link) => groups.findIndex(g => g.includes(link));
  const gathered = groups => {
    const add = list => list.reduce(plus, none);
    const flat = (values, part) => vector(values.flat(), v => v[part]);
    const k = groups.map(g => groups.map(h => [add(g.flatMap(i => h.map(j => K[i][j])))])).flat();
    const s = groups.map(g => add(g.map(i => S[i]))), r = groups.map(g => add(g.map(i => rows[i])));
    return { n: groups.length, groups, hip: hip.some(abs) && hip, massless, stance: placeOf(groups, 1), swing: placeOf(groups, 2), R: keys.R / leg, kr: flat(k, 0), ki: flat(k, 1),
      sr: flat([s], 0), si: flat([s], 1), rr: flat([r], 0), ri: flat([r], 1) };
  };
  const chains = Object.fromEntries(Object.entries(GROUPS).map(([name, groups]) => [name, gathered(groups)]));
  // The links of the walker during heelstrike, in which the trailing knee may be locked.
  const locks = keys.trailing_knee === "locked", striking = keys.knees && !locks ? chains.free : chains.locked;
  return { keys, kneed: Boolean(keys.knees), pointFoot, massless, ...chains, locks, striking, push: own("push_off") / (mass * Math.sqrt(leg * keys.g)), R: keys.R / leg, l: l / leg, foot, knee, leg, mass,
    time: Math.sqrt(leg / keys.g), speed: Math.sqrt(leg * keys.g), energy: mass * keys.g * leg };
}

/** Mass matrix of a chain at angles q, row by row. */
function massMatrix(chain, q, M = new Float64Array(chain.n ** 2)) {
  const { n, R } = chain;
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) {
    const c = cos(q[j] - q[i]), s = sin(q[j] - q[i]), at = i * n + j;
    M[at] = chain.kr[at] * c - chain.ki[at] * s;
  }
  for (let j = 0; j < n; j++) {
    const c = cos(q[j]), s = sin(q[j]);
    M[j] += R * (chain.sr[j] * s + chain.si[j] * c);
    M[j * n] += R * (chain.rr[j] * s + chain.ri[j] * c);
  }
  M[0] += R * R;
  return M;
}

/** Generalised forces of gravity and of the rates, f of M q'' = f. */
function forces(chain, q, rate, slope, f = new Float64Array(chain.n)) {
  const { n, R } = chain, down = sin(slope), normal = -cos(slope);
  let pull = down;
  for (let i = 0; i < n; i++) {
    const c = cos(q[i]), s = sin(q[i]);
    f[i] = -(chain.rr[i] * s + chain.ri[i] * c) * down + (chain.rr[i] * c - chain.ri[i] * s) * normal;
    for (let j = 0; j < n; j++) {
      const at = i * n + j, w = rate[j] * rate[j], between = q[j] - q[i];
      f[i] += w * (chain.kr[at] * sin(between) + chain.ki[at] * cos(between));
    }
    pull += rate[i] * rate[i] * (chain.sr[i] * c - chain.si[i] * s);
  }
  f[0] -= R * pull;
  if (chain.hip) {
    const { stance, swing, hip: [stiffness, damping, bias] } = chain;
    const torque = bias - stiffness * (q[swing] - q[stance]) - damping * (rate[swing] - rate[stance]);
    f[swing] += torque;
    if (!chain.massless) f[stance] -= torque;
  }
  return f;
}

/** Solve A x = b in place; row 0 is eliminated last, for its coupling to a massless leg is zero. */
function solveLast(A, b) {
  const n = b.length;
  for (let k = n - 1; k > 0; k--) for (let i = 0; i < k; i++) {
    const factor = A[i * n + k] / A[k * n + k];
    b[i] -= factor * b[k];
    for (let j = 0; j < k; j++) A[i * n + j] -= factor * A[k * n + j];
  }
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < i; j++) b[i] -= A[i * n + j] * b[j];
    b[i] /= A[i * n + i];
  }
  return b;
}

/** Derivative of a state by time. */
function derivative(chain, x, slope) {
  const { n } = chain, q = x.subarray(0, n), rate = x.subarray(n), out = new Float64Array(2 * n);
  out.set(rate);
  out.set(solveLast(massMatrix(chain, q), forces(chain, q, rate, slope)), n);
  return out;
}

// Dormand and Prince (J. Comput. Appl. Math. 6 (1980) 19-26), fifth order in six stages.
const STAGES = [[1 / 5], [3 / 40, 9 / 40], [44 / 45, -56 / 15, 32 / 9], [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
  [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656], [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84]];

/** State after a time step h; `first` is the derivative at its beginning. */
function advance(chain, x, first, slope, h) {
  const slopes = [first];
  let stage;
  for (const weights of STAGES) {
    stage = vector(x);
    weights.forEach((weight, k) => { for (let i = 0; i < stage.length; i++) stage[i] += h * weight * slopes[k][i]; });
    if (slopes.length < STAGES.length) slopes.push(derivative(chain, stage, slope));
  }
  return stage;
}

// The guard of the next strike and its rate: flexion of the knee, or the sum of the legs' angles.
const guard = x => x.length === 6 ? [x[1] - x[2], x[4] - x[5]] : [x[0] + x[1], x[2] + x[3]];

/**
 * Shares of a time step between which the guard falls through zero, or null; `after` is the state after a share. A guard
 * that turns within `slack` of zero strikes as it turns; a foot that is so near as the knee strikes, strikes with it.
 */
function bracket(x, next, after, slack) {
  const [a, da] = guard(x), [b, db] = guard(next);
  if (abs(a) <= slack && da < 0 && x.length === 4 && x[0] < 0) return [0, 0];
  if (a > 0 && b <= 0) return [0, 1];
  // Within the time step the guard may dip below zero and back, or rise above and back: how far is flown, not interpolated.
  const dips = a > 0 && da < 0 && db > 0, rises = a <= 0 && b <= 0 && da > 0 && db < 0;
  if (!dips && !rises) return null;
  let turn = 0, far = 0, rate = da;
  for (let k = 0; k < 4; k++) {
    turn = min(1, max(0, turn + rate / (da - db)));
    [far, rate] = guard(after(turn));
  }
  if (abs(far) <= slack) return [turn, turn];
  return dips && far <= 0 ? [0, turn] : rises && far > 0 ? [turn, 1] : null;
}

/** Share of a time step of length h at which the guard falls through zero, or -1; a foot strikes behind the stance leg only. */
function crossing(x, next, h, after, slack) {
  const ends = bracket(x, next, after, slack);
  if (!ends) return -1;
  let [low, high] = ends, at = (low + high) / 2;
  for (let k = 0; k < 60; k++) {
    const [g, rate] = guard(after(at)), newton = at - g / rate / h;
    if (g > 0) low = at; else high = at;
    const better = newton > low && newton < high ? newton : (low + high) / 2, change = abs(better - at);
    at = better;
    if (change < 1e-14) break;
  }
  return x.length === 6 || after(at)[0] < 0 ? at : -1;
}

/** Fly one phase to its strike: { samples: [time, state, derivative], end, time } or { samples, fall }. */
function flyPhase(chain, start, begin, slope, slack = 0) {
  const samples = [], h = TIME_STEP, free = start.length === 6;
  let x = start;
  for (let k = 0; ; k++) {
    const now = begin + k * h, first = derivative(chain, x, slope);
    samples.push([now, x, first]);
    const after = share => advance(chain, x, first, slope, share * h), next = after(1), share = crossing(x, next, h, after, slack);
    if (share >= 0) {
      const at = share * h, end = after(share);
      samples.push([now + at, end, derivative(chain, end, slope)]);
      return { samples, end, time: now + at };
    }
    x = next;
    const fall = !x.every(isFinite) ? "lost" : x[0] > MAX_ANGLE ? "backward" : x[0] < -MAX_ANGLE ? "forward"
      : now + h > MAX_TIME ? (free ? "knee" : "foot") : "";
    if (fall) {
      if (fall !== "lost") samples.push([now + h, x, derivative(chain, x, slope)]);
      return { samples, fall };
    }
  }
}

const product = (chain, q, rate) => {
  const M = massMatrix(chain, q), { n } = chain;
  return vector({ length: n }, (_, i) => sum(Array.from(rate, (r, j) => M[i * n + j] * r)));
};

/** Locked state after kneestrike: the momenta of the stance leg and of the whole swing leg are conserved. */
function lockKnee(walker, x) {
  const p = product(walker.free, x.subarray(0, 3), x.subarray(3)), q = [x[0], x[1]];
  return vector([...q, ...solveLast(massMatrix(walker.locked, q), vector([p[0], p[1] + p[2]]))]);
}

/** Velocity of the foot that lands, with the stance angle after heelstrike and the rates of both legs before it. */
const landing = (walker, angle, [stance, swing]) =>
  [-(walker.R + walker.l * cos(angle)) * (stance - swing), walker.l * sin(angle) * (stance + swing)];

/** Linear momentum that a unit rate of link j gives, as the rows of the chain have it. */
const lever = (chain, q, j) => {
  const [re, im] = turned([chain.rr[j], chain.ri[j]], q[j]);
  return [-im - (j === 0 ? chain.R : 0), re];
};

/** Direction of the push-off, and its share of the velocity of the trailing contact for a unit rate of each group of links. */
function pushing(walker, angle) {
  const toContact = minus(turned([0, -walker.l], -angle), [0, walker.R]), size = -hypot(...toContact);
  const u = toContact.map(v => v / size), knee = turned(walker.knee, -angle), rest = minus(toContact, knee);
  const shank = turned(minus([0, walker.l], [-walker.knee[0], -walker.knee[1]]), angle), thigh = turned([-walker.knee[0], -walker.knee[1]], angle);
  const arms = [[-shank[1] - walker.R, shank[0]], [-thigh[1], thigh[0]], [-knee[1], knee[0]], [-rest[1], rest[0]]];
  return { u, along: walker.striking.groups.map(g => sum(g.map(j => dot(u, arms[j])))) };
}

/** What a push-off does to a walker that stands on no foot: velocity of the point that will strike, rates, and its work. */
function pushOff(walker, angle) {
  const { u, along } = pushing(walker, angle), chain = walker.striking, { n } = chain, P = walker.push;
  if (walker.massless) return { u, velocity: u.map(v => P * v), rates: new Float64Array(n), work: P * P / 2 };
  const q = vector([angle, -angle, -angle]).subarray(0, n), M = massMatrix(chain, q), levers = Array.from(q, (_, j) => lever(chain, q, j));
  const rows = [[1, 0, ...levers.map(w => w[0])], [0, 1, ...levers.map(w => w[1])]];
  levers.forEach((w, i) => rows.push([...w, ...M.subarray(i * n, i * n + n)]));
  const given = [...u, ...along], [x, y, ...rates] = solveRows(rows, given.map(v => P * v));
  return { u, velocity: [x, y], rates, work: P / 2 * dot([x, y, ...rates], given) };
}

/** State just after heelstrike at a stance angle, from the rates of the old stance and swing leg before it. */
function strikeHeel(walker, angle, rates) {
  const chain = walker.striking, { n } = chain;
  const q = [angle, -angle, -angle].slice(0, n), before = [rates[1], rates[0], rates[0]].slice(0, n);
  const momentum = product(chain, q, before), velocity = landing(walker, angle, rates);
  for (let i = 0; i < n; i++) {
    const [x, y] = lever(chain, q, i);
    momentum[i] += x * velocity[0] + y * velocity[1];
  }
  if (walker.push) pushing(walker, angle).along.forEach((v, i) => { if (!walker.massless || !i) momentum[i] += walker.push * v; });
  const after = solveLast(massMatrix(chain, q), momentum);
  // A trailing knee that was locked meanwhile is released with the rate of the whole leg.
  return vector(walker.locks ? [...q, -angle, ...after, after[1]] : [...q, ...after]);
}

/**
 * Fly a step to its end from the state just after heelstrike, or from one within it at a time since it began.
 * { phases, period, kneestrike, before, end } - `before` the rates of both legs before heelstrike, `end` the state after
 * it - or { phases, fall } where it does not end in one. `slack` is how near to zero the guard of a strike
 * may turn that counts as a strike: that of an end of walking only just touches zero.
 */
function flyStep(walker, start, slope, begin = 0, slack = 0) {
  const phases = [], fell = fall => ({ phases, kneestrike, fall });
  let x = start, now = begin, kneestrike = null;
  if (!begin && !(x[0] > 0)) {
    phases.push(flyPhase(walker.locked, vector(x.length === 6 ? [x[0], x[1], x[3], x[4]] : x), 0, slope));
    return fell("backward");
  }
  if (x.length === 6) {
    phases.push(flyPhase(walker.free, x, now, slope, slack));
    if (phases[0].fall) return fell(phases[0].fall);
    kneestrike = now = phases[0].time;
    x = lockKnee(walker, phases[0].end);
  }
  const last = flyPhase(walker.locked, x, now, slope, slack);
  phases.push(last);
  if (last.fall) return fell(last.fall);
  const before = [last.end[2], last.end[3]], angle = (last.end[1] - last.end[0]) / 2;
  return { phases, period: last.time, kneestrike, before, end: strikeHeel(walker, angle, before) };
}
