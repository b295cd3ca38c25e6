// Gaits of a page by their addresses: walker and axes, slope, stance angle. A page holds starts along each branch, and
// on a lattice of each map; Newton's method leads from the nearest of them to the gait.

const LINES = JSON.parse(document.getElementById("lines")?.textContent ?? "[]");
// Maps of all figures, each of which adds its own.
const MAPS = [];
const RATES = ["stance_rate", "thigh_rate", "shank_rate"], NEAR = 0.12;

const walkers = new Map();
function walkerOf(keys) {
  const name = JSON.stringify(keys);
  if (!walkers.has(name)) walkers.set(name, makeWalker(keys));
  return walkers.get(name);
}

const sameLine = (a, b) => Object.keys({ ...a, ...b }).every(key => key in a && key in b && (a[key] === b[key] || abs(a[key] - b[key]) <= 1e-9 * abs(a[key])));
const lineAt = at => LINES.find(line => sameLine(line.at, at));

/** Selection that an address names: { at, slope, angle[, rates, free] }, or null where it names none. */
function readAddress(hash) {
  const given = new URLSearchParams(hash.replace(/^#/, "")), at = {};
  if (!given.has("slope") || !given.has("stance_angle")) return null;
  for (const [key, value] of given) if (!["slope", "stance_angle", "free", ...RATES].includes(key)) at[key] = key === "walker" ? value : Number(value);
  const rates = RATES.filter(name => given.has(name)).map(name => Number(given.get(name)));
  const [slope, angle] = [Number(given.get("slope")), Number(given.get("stance_angle"))];
  return [slope, angle, ...rates].every(Number.isFinite) ? { at, slope, angle, rates, free: given.has("free") } : { at, slope: NaN, angle: NaN };
}

/** Address of a gait, or of a motion that is none. */
function writeAddress(gait) {
  const brief = value => Number(value.toPrecision(8)), n = gait.start.length / 2;
  const rates = gait.free ? Object.fromEntries([0, 1, 2].slice(0, n).map(i => [RATES[i], brief(gait.start[n + i] / gait.walker.time)])) : {};
  return "#" + new URLSearchParams({ walker: gait.at.walker, ...gait.at, slope: brief(gait.slope), stance_angle: brief(gait.start[0]), ...rates, ...(gait.free ? { free: 1 } : {}) });
}

/** Place on a line's branches nearest to a slope and a stance angle: { branch, at, apart }, `at` counted in nodes. */
function placeOn(line, slope, angle) {
  const x = Math.log(slope), y = Math.log(angle);
  let best = null;
  line.branches.forEach((nodes, branch) => nodes.forEach((node, k) => {
    const next = nodes[k + 1] ?? node, a = [Math.log(node[0]), Math.log(node[1])], d = [Math.log(next[0]) - a[0], Math.log(next[1]) - a[1]];
    const size = d[0] ** 2 + d[1] ** 2, share = size ? Math.min(1, Math.max(0, ((x - a[0]) * d[0] + (y - a[1]) * d[1]) / size)) : 0;
    const apart = hypot(x - a[0] - share * d[0], y - a[1] - share * d[1]);
    if (!best || apart < best.apart) best = { branch, at: k + share, apart };
  }));
  return best;
}

/** Start at a place of a branch, between two nodes, and the branch's direction (ln angle, ln slope) there. */
function between(nodes, at) {
  const k = Math.min(Math.floor(at), Math.max(0, nodes.length - 2)), share = at - k, a = nodes[k], b = nodes[k + 1] ?? a;
  const start = a.map((v, i) => v > 0 && b[i] > 0 ? v ** (1 - share) * b[i] ** share : v + share * (b[i] - v));
  const d = [Math.log(b[1] / a[1]), Math.log(b[0] / a[0])], size = hypot(...d);
  return { slope: start[0], start: start.slice(1), along: size ? d.map(v => v / size) : null };
}

/** A gait found, with all that is shown of it. */
function describe(found, walker, more) {
  const { step, start, slope } = found, [stance, swing] = step.before;
  const multipliers = multipliersOf(found.jacobian).slice(0, walker.pointFoot ? 2 : 3);
  while (multipliers.length < (walker.kneed ? 4 : 3)) multipliers.push([0, 0]);
  return { ...more, walker, slope, start, step, multipliers, y: found.y, radius: hypot(...multipliers[0]),
    label: (swing - stance) / abs(stance) < 0.5 ? "long" : "short", losses: lossesOf(walker, step), violations: violationsOf(walker, start, step, slope) };
}

/** Gait of a line at a place of one of its branches; null where Newton's method finds none. */
function gaitAt(line, branch, at, target = null) {
  const walker = walkerOf(line.keys), nodes = line.branches[branch], { slope, start, along } = between(nodes, at);
  const [slope0, angle] = target ?? [slope, start[0]], factor = angle / start[0];
  const y = sectionOf(walker, stateOf(walker, [angle, ...start.slice(1).map(rate => rate * factor)]));
  let found = along && findGait(walker, y, slope0, along);
  // At a given slope the gait has that very slope, unless a fold is so near that Newton's method would leave the branch.
  if (target || !found) {
    const exact = findGait(walker, found ? found.y : y, slope0), way = found ? abs(along[0] / along[1] * Math.log(found.slope / slope0)) : 0.2;
    if (exact && abs(Math.log(exact.y[0] / (found ? found.y[0] : angle))) < 2 * way + 1e-4) found = exact;
  }
  if (!found || abs(Math.log(found.y[0] / angle)) > 0.2) return null;
  return describe(found, walker, { at: line.at, line, branch, place: at, command: `${line.command} --slope ${slope0 === found.slope ? slope0 : Number(found.slope.toPrecision(12))}` });
}

/** Gait of a line nearest to a slope and a stance angle; null where there is none. */
function gaitNear(line, slope, angle) {
  const place = line && slope > 0 && angle > 0 ? placeOn(line, slope, angle) : null;
  if (!place || place.apart >= NEAR) return null;
  const exact = gaitAt(line, place.branch, place.at, [slope, angle]), last = line.branches[place.branch].length - 1;
  // Where walking ends, or a strike is all but tangential, the nearest gait of the branch that is a step.
  for (const far of exact ? [] : [0.1, 0.5, 1, 2]) for (const at of [place.at - far, place.at + far]) {
    const near = at >= 0 && at <= last && gaitAt(line, place.branch, at);
    if (near) return { ...near, nearby: true };
  }
  return exact;
}

/** Gaits of a line at a slope, one for each passage of its branches. */
function gaitsAt(line, slope) {
  const found = [];
  line.branches.forEach((nodes, branch) => nodes.slice(0, -1).forEach((a, k) => {
    const b = nodes[k + 1];
    if (a[0] === b[0] || (a[0] - slope) * (b[0] - slope) > 0) return;
    const share = Math.log(slope / a[0]) / Math.log(b[0] / a[0]);
    const gait = gaitAt(line, branch, k + share, [slope, a[1] ** (1 - share) * b[1] ** share]);
    if (gait && !found.some(other => abs(other.start[0] / gait.start[0] - 1) < 1e-6)) found.push(gait);
  }));
  return found;
}

/** A motion from any state: rates in the walker's units; `before` for those of kneed walkers just before heelstrike. */
function freeMotion(given, { slope, angle, rates, before }) {
  const walker = walkerOf(given.keys), [stance, thigh] = rates.map(rate => rate * walker.time);
  const start = before && walker.kneed ? stateAt(walker, [angle, stance, thigh]) : stateOf(walker, [angle, ...rates]);
  const near = angle > 0 ? findGait(walker, sectionOf(walker, start), slope) : null;
  const shown = near ? describe(near, walker, {}) : {};
  return { at: given.at, line: given, walker, slope, start, free: true, multipliers: shown.multipliers, radius: shown.radius, near: near?.y[0],
    command: given.command && `${given.command} --slope ${slope}`, step: flyStep(walker, start, slope) };
}

/** Keys of the walker of a map's cell. */
function keysOf(panel, values) {
  const keys = { ...panel.keys, ...values };
  for (const [key, [axis, list]] of Object.entries(panel.moved ?? {})) {
    const side = panel.x.name === axis ? panel.x : panel.y, k = side.values.findIndex(value => value >= values[axis] - 1e-12);
    keys[key] = list[k];
  }
  delete keys.slope;
  return keys;
}

/** Gait of the maps' cell that an address names, where no line has it; null where there is none. */
function gaitOnMaps({ at, slope, angle }) {
  const wanted = { ...at, slope }, indexOf = side => side.values.findIndex(value => abs(value - wanted[side.name]) <= 1e-7 * abs(value));
  for (const panel of MAPS.filter(one => !one.free)) {
    const cell = [indexOf(panel.x), indexOf(panel.y)], of = { ...panel.at, [panel.x.name]: at[panel.x.name], [panel.y.name]: at[panel.y.name] };
    delete of.slope;
    const gait = sameLine(of, at) && !cell.includes(-1) ? gaitOfCell(panel, ...cell) : null;
    if (gait && hypot(Math.log(gait.slope / slope), Math.log(gait.start[0] / angle)) < 1e-3) return gait;
  }
  return null;
}

/** Gait of a cell of a map, from the nearest start of its lattice; null where there is none. */
function gaitOfCell(panel, column, row) {
  const valueAt = (i, j) => ({ [panel.x.name]: panel.x.values[i], [panel.y.name]: panel.y.values[j] });
  const nodes = panel.rows.flatMap((j, a) => panel.columns.map((i, b) => ({ i, j, start: panel.starts[a][b] }))).filter(node => node.start);
  const far = node => hypot((node.i - column) / panel.x.values.length, (node.j - row) / panel.y.values.length);
  nodes.sort((p, q) => far(p) - far(q));
  const target = valueAt(column, row), slopeOf = (values, fallback) => values.slope ?? panel.at.slope ?? fallback;
  for (const node of nodes.slice(0, 4)) {
    const from = valueAt(node.i, node.j), [slope0, ...start] = "slope" in from ? [from.slope, ...node.start] : node.start, walker = walkerOf(keysOf(panel, from));
    const first = findGait(walker, sectionOf(walker, stateOf(walker, start)), slope0);
    if (!first) continue;
    // From the node to the cell in as many parts as Newton's method needs; keys that derive from others only arrive.
    for (const parts of [1, 2, 4, 8]) {
      let y = first.y, found = null;
      for (let k = 1; k <= parts && y; k++) {
        const mix = {};
        for (const key of Object.keys(target)) mix[key] = from[key] + (target[key] - from[key]) * k / parts;
        const here = makeWalker(k < parts && Object.keys(panel.moved ?? {}).length ? keysOf(panel, target) : keysOf(panel, mix));
        found = findGait(here, y, slopeOf(mix, slope0));
        y = found && abs(Math.log(found.y[0] / y[0])) < 0.5 ? found.y : null;
      }
      if (!y) continue;
      const at = { ...panel.at, ...target };
      delete at.slope;
      const set = Object.entries(target).filter(([key]) => key !== "slope").map(([key, value]) => ` --set ${key}=${value}`).join("");
      return describe(found, makeWalker(keysOf(panel, target)), { at, panel, cell: [column, row], command: `${panel.command}${set} --slope ${found.slope}` });
    }
  }
  return null;
}
