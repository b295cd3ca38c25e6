// Gaits: fixed points of the step map by Newton's method, their multipliers, losses and violations.
//
// Section coordinates y are three for every walker: the stance angle and both rates after heelstrike or, with knees, the
// angle and the rates of the old stance and swing leg before it, of which the three rates after it are linear.

const stateAt = (walker, y) => walker.kneed ? strikeHeel(walker, y[0], [y[1], y[2]]) : vector([y[0], -y[0], y[1], y[2]]);

/** Section coordinates of a state just after heelstrike: with knees, of the nearest that a heelstrike gives. */
function sectionOf(walker, x) {
  if (!walker.kneed) return [x[0], x[2], x[3]];
  const gained = strikeHeel(walker, x[0], [0, 0]).slice(3);
  const rates = x.slice(3).map((v, i) => v - gained[i]);
  const [u, v] = [[1, 0], [0, 1]].map(unit => strikeHeel(walker, x[0], unit).slice(3).map((w, i) => w - gained[i])), share = dot(u, v) / dot(u, u);
  const rest = v.map((value, i) => value - share * u[i]), swing = dot(rest, rates) / dot(rest, rest);
  return [x[0], dot(u, rates) / dot(u, u) - share * swing, swing];
}

/** A state from the angle and the rates just after heelstrike, in the walker's units; absent rates are what the impact gives. */
function stateOf(walker, [angle, stance, thigh, shank]) {
  const rates = [stance, thigh, shank ?? thigh].slice(0, walker.kneed ? 3 : 2).map(rate => rate * walker.time);
  if (isFinite(thigh)) return vector([angle, -angle, ...(walker.kneed ? [-angle] : []), ...rates]);
  const [unit, none] = [[1, 0], [0, 0]].map(before => strikeHeel(walker, angle, before)), k = unit.length / 2;
  return strikeHeel(walker, angle, [(rates[0] - none[k]) / (unit[k] - none[k]), 0]);
}

/** Image of section coordinates under a step, or null after a fall. */
function stepMap(walker, y, slope) {
  const step = y[0] > 0 ? flyStep(walker, stateAt(walker, y), slope) : { fall: "backward" };
  return step.fall ? null : walker.kneed ? [step.end[0], ...step.before] : sectionOf(walker, step.end);
}

/** Derivative of the step map by its coordinates and, last, by ln slope: rows of four; differences, central if both fly. */
function mapJacobian(walker, y, slope) {
  const here = stepMap(walker, y, slope), rate = max(abs(y[1]), abs(y[2])), columns = [];
  for (let k = 0; k < 4 && here; k++) {
    let column = null;
    // Beside the ends of walking a shorter step flies, or one to one side.
    for (const share of [1e-6, 1e-7, 1e-8]) {
      const d = share * (k === 3 ? 1 : k ? rate : y[0]);
      const [above, below] = [d, -d].map(h => k === 3 ? stepMap(walker, y, slope * Math.exp(h)) : stepMap(walker, y.map((v, i) => i === k ? v + h : v), slope));
      if (!above && !below) continue;
      column = here.map((v, i) => ((above ?? here)[i] - (below ?? here)[i]) / (above && below ? 2 * d : d));
      if (above && below) break;
    }
    if (!column) return null;
    columns.push(column);
  }
  return here && [0, 1, 2].map(i => columns.map(column => column[i]));
}

/** Solve A x = b by elimination with pivots; A is a list of rows. */
function solveRows(A, b) {
  const n = b.length, rows = A.map((row, i) => [...row, b[i]]);
  for (let k = 0; k < n; k++) {
    const best = rows.slice(k).reduce((at, row, i) => abs(row[k]) > abs(rows[at][k]) ? k + i : at, k);
    [rows[k], rows[best]] = [rows[best], rows[k]];
    for (let i = 0; i < n; i++) if (i !== k) {
      const factor = rows[i][k] / rows[k][k];
      for (let j = k; j <= n; j++) rows[i][j] -= factor * rows[k][j];
    }
  }
  return rows.map((row, i) => row[n] / row[i]);
}

/**
 * Newton's method for a gait, from section coordinates and a slope; null where it does not converge.
 *
 * With `free` the slope is an unknown too, and the gait found is the nearest of its branch in ln angle and ln slope: so a
 * fold is passed as any other point of a branch. Rates, of which a page holds few digits, change freely.
 */
function findGait(walker, start, slope0, free = false) {
  let y = [...start], slope = slope0, J = null, last = Infinity;
  for (let k = 0; k < 30; k++) {
    const image = stepMap(walker, y, slope);
    // The derivative is kept while Newton's method gains a digit with it.
    J = image && (J ?? mapJacobian(walker, y, slope));
    if (!J) return null;
    const rate = max(abs(y[1]), abs(y[2])), scale = [y[0], rate, rate], weight = free ? [1, 1e3, 1e3, 1] : [1, 1, 1, 0];
    const A = scale.map((size, i) => [...scale, 1].map((by, j) => ((i === j ? 1 : 0) - J[i][j]) * by / size * weight[j]));
    const residual = image.map((v, i) => (v - y[i]) / scale[i]);
    const change = (free ? leastChange(A, residual) : [...solveRows(A.map(row => row.slice(0, 3)), residual), 0]).map((c, j) => c * weight[j]);
    const size = max(...change.map(abs));
    if (!isFinite(size)) return null;
    const damp = min(1, 0.3 / size);
    y = y.map((v, i) => v + damp * change[i] * scale[i]);
    slope *= Math.exp(damp * change[3]);
    if (size < 1e-9 || (size < 1e-7 && size >= last / 2)) {
      const state = stateAt(walker, y), step = flyStep(walker, state, slope), jacobian = !step.fall && mapJacobian(walker, y, slope);
      return jacobian && { y, slope, step, start: state, jacobian: jacobian.map(row => row.slice(0, 3)) };
    }
    if (size > 0.1 * last || size > 0.01) J = null;
    last = size;
  }
  return null;
}

/** The shortest x of A x = b, for fewer rows than columns. */
function leastChange(A, b) {
  const part = solveRows(A.map(row => A.map(other => dot(row, other))), b);
  return A[0].map((_, j) => sum(A.map((row, i) => row[j] * part[i])));
}

/** Eigenvalues [re, im] of a 3 by 3 matrix, largest first: the roots of its characteristic polynomial. */
function multipliersOf(J) {
  const minor = (i, j) => J[i][i] * J[j][j] - J[i][j] * J[j][i];
  const det = J[0][0] * minor(1, 2) - J[0][1] * (J[1][0] * J[2][2] - J[1][2] * J[2][0]) + J[0][2] * (J[1][0] * J[2][1] - J[1][1] * J[2][0]);
  const c = [-det, minor(0, 1) + minor(0, 2) + minor(1, 2), -(J[0][0] + J[1][1] + J[2][2])];
  const size = max(abs(c[2]), Math.sqrt(abs(c[1])), Math.cbrt(abs(c[0]))) || 1;
  const a = [c[0] / size ** 3, c[1] / size ** 2, c[2] / size];
  const value = z => plus(multiply(plus(multiply(plus(z, [a[2], 0]), z), [a[1], 0]), z), [a[0], 0]);
  const divide = (p, q) => { const r = multiply(p, conjugate(q)), d = q[0] ** 2 + q[1] ** 2; return d ? [r[0] / d, r[1] / d] : [0, 0]; };
  // Durand and Kerner's iteration.
  let roots = [[1, 0], [0.4, 0.9], [-0.65, 0.72]];
  for (let k = 0; k < 200; k++) roots = roots.map((z, i) =>
    minus(z, divide(value(z), roots.reduce((p, other, j) => i === j ? p : multiply(p, minus(z, other)), [1, 0]))));
  const clean = roots.map(z => z.map(v => abs(v) < 1e-9 ? 0 : v * size));
  return clean.sort((p, q) => hypot(...q) - hypot(...p) || q[1] - p[1]);
}

/** Rates of a chain for unit impulses along rows: r M^-1 r^T. */
function compliance(chain, q, rows) {
  const responses = rows.map(row => solveLast(massMatrix(chain, q), vector(row)));
  return rows.map(row => responses.map(response => dot(row, response)));
}

/** Energies lost in a step, in weight times leg, on the eigenvectors of the contact mass matrix and at kneestrike. */
function lossesOf(walker, step) {
  const angle = step.end[0], pushed = walker.push && pushOff(walker, angle).velocity, chain = walker.striking;
  const v = plus(landing(walker, angle, step.before), pushed || [0, 0]);
  const found = { normal: 0, tangential: 0, kneestrike: 0 };
  if (walker.massless) {
    const toHip = [-walker.l * sin(angle), walker.R + walker.l * cos(angle)];
    found.normal = 0.5 * ((toHip[0] * v[0] + toHip[1] * v[1]) / hypot(...toHip)) ** 2;
  } else {
    const q = Array.from(step.end.subarray(0, chain.n)), levers = q.map((_, j) => lever(chain, q, j));
    const [[xx, xy], [, yy]] = compliance(chain, q, [levers.map(w => w[0]), levers.map(w => w[1])]);
    const turn = 0.5 * Math.atan2(-2 * xy, yy - xx);
    const losses = [[cos(turn), sin(turn)], [-sin(turn), cos(turn)]].map(([ex, ey]) =>
      [abs(ey), 0.5 * (1 - (ex * ex * xx + 2 * ex * ey * xy + ey * ey * yy)) * (ex * v[0] + ey * v[1]) ** 2]);
    losses.sort((p, q) => q[0] - p[0]);
    [found.normal, found.tangential] = losses.map(loss => loss[1]);
  }
  if (walker.kneed) {
    const x = step.phases[0].end, [[soft]] = compliance(walker.free, x.subarray(0, 3), [[0, 1, -1]]);
    found.kneestrike = 0.5 * (x[4] - x[5]) ** 2 / soft;
  }
  return found;
}

const momentumOf = (chain, q, rate) => Array.from(q).reduce((total, _, j) => {
  const [re, im] = turned([chain.sr[j], chain.si[j]], q[j]);
  return plus(total, [rate[j] * (-im - (j === 0 ? chain.R : 0)), rate[j] * re]);
}, [0, 0]);

/** Angles, or rates, of the four links from those of the links that move by themselves. */
const ofLinks = ([stance, thigh, shank = thigh]) => [stance, stance, thigh, shank];

/** Height of the swing foot's lowest point, without cancellation for short steps, and the parts of its rate by the four angles. */
function footHeight(walker, [a, , b, c]) {
  const bent = 2 * sin((c - b) / 2) * turned(walker.foot, (b + c) / 2)[0];
  return -2 * walker.l * sin((a + b) / 2) * sin((a - b) / 2) + bent;
}
const rising = ({ foot, knee }) => [[-foot[0], -foot[1]], [-knee[0], -knee[1]], knee, foot];
const climbing = (walker, q, rate) => rising(walker).map((arm, j) => turned(arm, q[j])[0] * rate[j]);

/** Generalised torque on the stance thigh that its locked knee gives: residual of the thigh's own equation. */
function kneeTorque(walker, q, rate, acceleration, slope) {
  const M = massMatrix(walker.open, q), f = forces(walker.open, q, rate, slope);
  return sum(acceleration.map((a, j) => M[4 + j] * a)) - f[1];
}

/** Names of the physical assumptions that a step violates by more than their limits (appendix A of the paper); null where a step ends in a fall. */
function violationsOf(walker, start, step, slope) {
  if (step.fall) return null;
  const worst = VIOLATIONS.map(() => 0), ratio = ([x, y]) => y > 0 ? abs(x) / y : Infinity;
  const note = (number, amount) => { worst[number] = max(worst[number], amount); };
  const contact = force => {
    note(2, -force[1]);
    note(3, ratio(force));
  };
  step.phases.forEach((phase, number) => phase.samples.forEach(([time, x, dx], k) => {
    const n = x.length / 2, chain = n === 3 ? walker.free : walker.locked;
    const q = x.subarray(0, n), rate = x.subarray(n), acceleration = dx.subarray(n);
    let force = [-chain.R * acceleration[0] - sin(slope), cos(slope)];
    q.forEach((angle, j) => { force = plus(force, multiply([-(rate[j] ** 2), acceleration[j]], turned([chain.sr[j], chain.si[j]], angle))); });
    contact(force);
    const atEnd = (number === 0 && k === 0) || (number === step.phases.length - 1 && k === phase.samples.length - 1);
    if (!atEnd) note(0, -footHeight(walker, ofLinks(q)));
    // Between two samples the foot is lowest where its rate, interpolated linearly, vanishes.
    const next = phase.samples[k + 1], [falls, rises] = [x, next?.[1] ?? x].map(y => sum(climbing(walker, ofLinks(y.subarray(0, n)), ofLinks(y.subarray(n)))));
    if (falls < 0 && rises > 0) {
      const lowest = advance(chain, x, dx, slope, (next[0] - time) * falls / (falls - rises));
      note(0, -footHeight(walker, ofLinks(lowest.subarray(0, n))));
    }
    if (walker.kneed) note(1, -kneeTorque(walker, ...[q, rate, acceleration].map(ofLinks), slope));
    if (n === 3 && number === 0) note(4, q[2] - q[1]);
  }));
  const n = start.length / 2, chain = n === 3 ? walker.free : walker.locked, open = walker.open;
  const impulse = (at, after, before, velocity, atKnee) => {
    const q = ofLinks(at), change = ofLinks(after).map((r, j) => r - ofLinks(before)[j]);
    contact(minus(momentumOf(open, q, change), velocity));
    if (!walker.kneed) return;
    const M = massMatrix(open, q), lock = link => {
      const [x, y] = turned([-open.si[link], open.sr[link]], q[link]);
      return sum(change.map((c, j) => M[4 * link + j] * c)) - (atKnee ? 0 : x * velocity[0] + y * velocity[1]);
    };
    note(1, -lock(1));
    if (walker.locks && !atKnee) note(7, lock(3));
  };
  let before = [step.before[1], step.before[0], step.before[0]].slice(0, n), velocity = landing(walker, step.end[0], step.before);
  if (walker.push) {
    const push = pushOff(walker, step.end[0]);
    before = before.map((rate, i) => rate + (push.rates[i] ?? push.rates[1]));
    velocity = plus(velocity, push.velocity);
    note(8, ratio(push.u));
    note(9, velocity[1]);
  }
  impulse(step.end.subarray(0, n), step.end.subarray(n), before, velocity, false);
  if (walker.kneed) {
    const x = step.phases[0].end, y = step.phases[1].samples[0][1];
    impulse(x.subarray(0, 3), [y[2], y[3], y[3]], x.subarray(3), [0, 0], true);
  }
  const q = ofLinks(start.subarray(0, n)), rate = ofLinks(start.subarray(n));
  const acceleration = ofLinks(derivative(chain, start, slope).subarray(n));
  const arms = rising(walker).map((arm, j) => turned(arm, q[j])), parts = climbing(walker, q, rate);
  const leaving = sum(parts), still = abs(leaving) <= 1e-12 * sum(parts.map(abs));
  const lift = sum(arms.map((arm, j) => arm[0] * acceleration[j] - rate[j] ** 2 * arm[1]));
  if ((still ? lift : leaving) < 0) {
    const heights = step.phases[0].samples.slice(1).map(([, x]) => footHeight(walker, ofLinks(x.subarray(0, n))));
    const rises = heights.findIndex(height => height >= 0);
    note(5, max(0, ...heights.slice(0, rises < 0 ? undefined : rises).map(height => -height)));
  }
  if (!still && leaving < 0 && !walker.massless) {
    const [s1, s2, thigh, shank] = arms.map(arm => arm[0]), { striking } = walker;
    const row = striking.n === 3 ? [s1 + s2, thigh, shank] : [s1 + s2, thigh + shank];
    note(6, -leaving / compliance(striking, start.subarray(0, striking.n), [row])[0][0]);
  }
  return VIOLATIONS.filter((_, number) => worst[number] > (walker.keys.violation_limits?.[number] ?? 0));
}
