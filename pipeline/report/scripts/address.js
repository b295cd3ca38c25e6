// Gaits of a page by their addresses: walker and axes, slope, state just after heelstrike. A page holds the state of every
// mark and of every cell of a map, and starts along each branch.

const [LINES, STATES] = ["lines", "states"].map(id => JSON.parse(document.getElementById(id)?.textContent ?? "[]"));
// Maps of all figures, each of which adds its own, and grids of which slices are shown.
const MAPS = [], GRIDS = [];
const RATES = ["stance_rate", "thigh_rate", "shank_rate"], NEAR = 0.12;

const walkers = new Map();
function walkerOf(keys) {
  const name = JSON.stringify(keys);
  if (!walkers.has(name)) walkers.set(name, makeWalker(keys));
  return walkers.get(name);
}

const isAt = (a, b) => a === b || abs(a - b) <= 1e-9 * abs(a);
const sameLine = (a, b) => Object.keys({ ...a, ...b }).every(key => key in a && key in b && isAt(a[key], b[key]));
/**
 * Line at values of its axes; of one along what drives at a slope the walker that these make, whose line is `over`. A walker
 * alone may be one by whose name a page calls a line.
 */
function lineAt(at, slope) {
  for (const line of LINES) {
    const { along } = line;
    if (sameLine(line.at, at) || sameLine({ walker: line.called }, at)) return line;
    if (along && sameLine({ ...line.at, [along]: at[along] }, { ...at, slope })) return { ...line, at, over: line.command, keys: { ...line.keys, [along]: at[along] }, command: line.command + at[along] };
  }
}

/** Line of a grid at values of its axes, from whose cells gaits start; undefined where the grid has no such values. */
function lineOfGrid(at) {
  for (const { axes, lines } of GRIDS) for (const own of lines) {
    const { slope, ...fixed } = own.at, others = axes.filter(axis => axis.name !== "slope");
    for (const { name, values } of others) fixed[name] = values.find(value => isAt(value, at[name]));
    if (sameLine(fixed, at)) return { ...own, at, keys: keysOf({ ...own, axes }, at), branches: [], command: own.command + others.map(({ name }) => ` --set ${name}=${at[name]}`).join("") };
  }
}

/** Cells of maps of gaits at values of their axes: [map, cell] each. */
const cellsAt = (at, slope) => gaitMaps().map(map => [map, [map.x, map.y].map(({ name, values }) => values.findIndex(value => isAt(value, { ...at, slope }[name])))])
  .filter(([map, cell]) => !cell.includes(-1) && sameLine(cellOf(map, cell).at, at));
const gaitMaps = () => MAPS.filter(map => !map.free);

/** Line of the walker of a cell, at any slope: its gaits are searched for. */
function lineOfCell(at) {
  for (const [map, cell] of cellsAt(at)) return { ...map, at, keys: keysOf(map, at), branches: [], command: cellOf(map, cell).command };
}

/**
 * Selection that an address names: { at, slope, start[, free] }; null where it names a place of the page. Of what it leaves
 * out the slope is NaN, and the start is empty. `wrong` is the first of its keys without a value that can be read.
 */
function readAddress(hash) {
  if (!hash.includes("=")) return null;
  const given = new URLSearchParams(hash.replace(/^#/, "")), at = {};
  for (const [wrong, value] of given) if (!value || wrong !== "walker" && !isFinite(Number(value))) return { at, slope: NaN, start: [], wrong };
  for (const [key, value] of given) if (!["slope", "stance_angle", "free", ...RATES].includes(key)) at[key] = key === "walker" ? value : Number(value);
  const slope = given.has("slope") ? Number(given.get("slope")) : NaN, start = ["stance_angle", ...RATES].filter(name => given.has(name)).map(name => Number(given.get(name)));
  return { at, slope, start, free: given.has("free") };
}

/** Address of a gait, or of a motion that is none: its line, its slope and its state just after heelstrike. */
function writeAddress(gait) {
  const n = gait.start.length / 2, state = ["stance_angle", ...RATES].slice(0, n + 1).map((name, i) => [name, Number((i ? gait.start[n + i - 1] / gait.walker.time : gait.start[0]).toPrecision(9))]);
  return "#" + new URLSearchParams({ walker: gait.at.walker, ...gait.at, slope: gait.slope, ...Object.fromEntries(state), ...(gait.free ? { free: 1 } : {}) });
}

/** Place on a line's branches nearest to a slope and a stance angle: { branch, at, apart }, `at` counted in nodes. */
function placeOn(line, slope, angle) {
  const x = rank(slope), y = log(angle);
  let best = null;
  line.branches.forEach((nodes, branch) => nodes.forEach((node, k) => {
    const next = nodes[k + 1] ?? node, a = [rank(node[0]), log(node[1])], d = [rank(next[0]) - a[0], log(next[1]) - a[1]];
    const size = d[0] ** 2 + d[1] ** 2, share = size ? min(1, max(0, ((x - a[0]) * d[0] + (y - a[1]) * d[1]) / size)) : 0;
    const apart = hypot(x - a[0] - share * d[0], y - a[1] - share * d[1]);
    if (!best || apart < best.apart) best = { branch, at: k + share, apart };
  }));
  return best;
}

/** Slope and start at a place of a branch, between two nodes. */
function between(nodes, at) {
  const k = min(floor(at), max(0, nodes.length - 2)), share = at - k, a = nodes[k], b = nodes[k + 1] ?? a;
  const [slope, ...start] = a.map((v, i) => v > 0 && b[i] > 0 ? v ** (1 - share) * b[i] ** share : v + share * (b[i] - v));
  return { slope, start };
}

/** A gait flown, with all that is shown of it; `found` has the derivative of the step map unless it is none there. */
function describe(found, walker, more) {
  const { step, start, slope, jacobian } = found, [stance, swing] = step.before, multipliers = jacobian && multipliersOf(jacobian).slice(0, walker.pointFoot ? 2 : 3);
  while (multipliers && multipliers.length < (walker.kneed ? 4 : 3)) multipliers.push([0, 0]);
  return { slope, ...more, walker, start, step, multipliers, y: found.y, radius: multipliers ? hypot(...multipliers[0]) : undefined,
    label: (swing - stance) / abs(stance) < 0.5 ? "long" : "short", losses: lossesOf(walker, step), violations: violationsOf(walker, start, step, slope) };
}

/** Command of a line at a slope, or at what else drives, by which it ends; some have their slope. */
const withSlope = (command, slope) => command && (command.endsWith("=") ? command + slope : command.includes(" --slope ") ? command : `${command} --slope ${slope}`);

/**
 * The gait that a page holds with its slope and start, polished to the digits of this script's own flight; null where it
 * does not walk. Its slope is the archive's, and so are its command's and its address's. With `exact` a state that only
 * nearly repeats itself is none.
 */
function storedGait({ keys, command, slope, start, exact, ...more }) {
  const walker = walkerOf(keys), state = stateOf(walker, start), y = sectionOf(walker, state), told = { ...more, slope, command: withSlope(command, slope) };
  if (!(leads(keys, slope) && start[0] > 0)) return null;
  // Where walking ends a strike only just touches, or two coincide, and Newton's method has no derivative.
  const [plain, touching] = [0, 1e-6 * start[0]].map(slack => flyStep(walker, state, slope, 0, slack));
  const [miss, least] = [plain, touching].map(({ fall, end }) => fall ? Infinity : abs(end[0] / start[0] - 1));
  if (least < 1e-7 && least < miss) return describe({ y, slope, start: state, step: touching }, walker, told);
  const found = findGait(walker, y, slope, true);
  if (found && hypot(rank(found.slope) - rank(slope), log(found.y[0] / start[0])) < 1e-6) return describe(found, walker, told);
  // Beside those ends, too, the stored state flies, and returns to itself; of another state the gait is solved.
  return miss < (exact ? 1e-6 : 1e-3) ? describe({ y, slope, start: state, step: plain }, walker, told) : null;
}

/** Gait of a line at a place of one of its branches; null where Newton's method finds none. */
function gaitAt(line, branch, at) {
  const { slope, start } = between(line.branches[branch], at), walker = walkerOf(line.keys);
  const found = findGait(walker, sectionOf(walker, stateOf(walker, start)), slope, true);
  if (!found || abs(log(found.y[0] / start[0])) > 0.2) return null;
  const shown = Number(found.slope.toPrecision(12));
  return describe(found, walker, { at: line.at, line, branch, place: at, slope: shown, command: withSlope(line.command, shown) });
}

/** Gait of a line at a slope, by Newton's method from a start; null where there is none beside it. */
function gaitAtSlope(line, slope, start, more = {}) {
  const walker = walkerOf(line.keys), found = findGait(walker, sectionOf(walker, stateOf(walker, start)), slope);
  return found && abs(log(found.y[0] / start[0])) < 0.1 ? describe(found, walker, { at: line.at, line, ...more, command: withSlope(line.command, slope) }) : null;
}

/**
 * Gait of a line with a slope and a start, of which the rates may be absent, or the angle too; null where there is none.
 * What is shown is always solved: a start that only looks like a gait is where Newton's method begins.
 */
function gaitNear(line, slope, given) {
  if (!leads(line.keys, slope)) return null;
  if (!given.length) {
    const on = gaitsAt(line, slope), all = on[0] ? on : searched(line, slope);
    return all.find(gait => gait.radius < 1) ?? all[0];
  }
  const [angle] = given, place = angle > 0 && line.branches.length ? placeOn(line, slope, angle) : null;
  const on = place && place.apart < NEAR ? { branch: place.branch, place: place.at } : {}, own = { at: line.at, line, keys: line.keys, command: line.command, ...on };
  let exact = null;
  if (given.length > (line.keys.knees ? 3 : 2)) exact = storedGait({ ...own, slope, start: given, exact: true }) ?? gaitAtSlope(line, slope, given, on) ?? storedGait({ ...own, slope, start: given });
  else if ("place" in on) {
    const near = between(line.branches[on.branch], on.place).start;
    exact = gaitAtSlope(line, slope, near.map(x => x * angle / near[0]), on) ?? gaitAtSlope(line, slope, near, on);
  } else if (angle > 0) exact = gaitGuessed(line, slope, angle);
  if (exact || !("place" in on)) return exact;
  // Where walking ends, or a strike is all but tangential, the nearest gait of the branch that is a step.
  const last = line.branches[on.branch].length - 1;
  for (const far of [0.1, 0.5, 1, 2]) for (const at of [on.place - far, on.place + far]) {
    const near = at >= 0 && at <= last && gaitAt(line, on.branch, at);
    if (near) return { ...near, nearby: true };
  }
  return null;
}

/** Gait of a line with a slope and an angle, of whose rates nothing is known: those of gaits are shares of the angle. */
function gaitGuessed(line, slope, angle, within = 0.01) {
  const { time } = walkerOf(line.keys);
  for (const stance of [1, 1.25, 1.1, 1.5]) for (const swing of [0.05, 0.35, 0.7, 0.9, 1.1]) {
    const found = gaitAtSlope(line, slope, [angle, ...[1, swing, swing].map(share => -share * stance * angle / time)]);
    if (found && abs(found.start[0] / angle - 1) < within) return found;
  }
  return null;
}

/** Gaits at a slope of a line that are on none of its stored branches: their angles are near the cube root of the slope. */
const searched = (line, slope) => [0.6, 0.72, 0.86, 1.03, 1.2]
  .map(share => gaitGuessed(line, slope, share * (slope > 0 ? slope ** (1 / 3) : 0.3), 0.1)).filter(Boolean);

/** Keys of lines and maps of a walker that an address does not give. */
function missing(at) {
  const own = [...LINES, ...gaitMaps()].find(one => one.at.walker === at.walker);
  return own ? [...Object.keys(own.at), own.x?.name, own.y?.name].filter(name => name && !(name in { slope: 0, ...at })) : [];
}

/** Why an address names no gait of this page: what is the nearest that the page has. */
function whyNot({ at, slope, start, wrong }) {
  if (wrong) return `The address has no valid value for ${wrong}. It may be cut off.`;
  const where = `slope ${brief(slope, 6)}`;
  const absent = missing(at), none = `No gait was found at ${where}.`, line = lineAt(at, slope), said = all => Object.entries(all).map(([key, value]) => `${key} = ${typeof value === "number" ? brief(value, 6) : value}`).join(", ");
  if (line) {
    const slopes = line.branches.flat().map(node => node[0]), low = min(...slopes), high = max(...slopes);
    if (isNaN(slope)) return "The address has no slope.";
    if (!leads(line.keys, slope)) return `Nothing drives this walker at ${where}.`;
    if (low < high && (slope < low || slope > high)) return `At ${where} this line has no gait: its gaits are at slopes from ${brief(low, 5)} to ${brief(high, 5)} rad.`;
    return start.length ? `No gait of this line is near ${where} and stance angle ${brief(start[0], 6)}.` : none;
  }
  for (const map of gaitMaps()) for (const side of [map.x, map.y]) {
    const value = at[side.name];
    if (value === undefined || side.values.some(one => isAt(one, value))) continue;
    const nearest = side.values.reduce((best, one) => abs(one - value) < abs(best - value) ? one : best);
    return `${side.name} = ${brief(value, 6)} is not on the map: its nearest value is ${brief(nearest, 6)}.`;
  }
  if (lineOfCell(at)) return none;
  if (absent.length) return `The address does not give ${absent.join(" and ")}.`;
  return Object.keys(at).length ? `This page has no line with ${said(at)}.` : "The address names no line.";
}

/** Gaits of a line at a slope, one for each passage of its branches. */
function gaitsAt(line, slope) {
  const found = [];
  line.branches.forEach((nodes, branch) => nodes.slice(0, -1).forEach((a, k) => {
    const b = nodes[k + 1];
    if (a[0] === b[0] || (a[0] - slope) * (b[0] - slope) > 0) return;
    const place = k + (rank(slope) - rank(a[0])) / (rank(b[0]) - rank(a[0])), gait = gaitAtSlope(line, slope, between(nodes, place).start, { branch, place });
    if (gait && !found.some(other => abs(other.start[0] / gait.start[0] - 1) < 1e-6)) found.push(gait);
  }));
  return found;
}

/** A motion from any state: rates in the walker's units; `before` for those of kneed walkers just before heelstrike. */
function freeMotion(given, { slope, start: [angle, ...rates], before }) {
  const walker = walkerOf(given.keys), [stance, thigh] = rates.map(rate => rate * walker.time);
  const start = before && walker.kneed ? stateAt(walker, [angle, stance, thigh]) : stateOf(walker, [angle, ...rates]);
  const near = angle > 0 ? findGait(walker, sectionOf(walker, start), slope) : null;
  const shown = near ? describe(near, walker, {}) : {}, n = start.length / 2, state = [start[0], ...start.slice(n, n + 2).map(rate => rate / walker.time)].join(" ");
  return { at: given.at, line: given, walker, slope, start, free: true, multipliers: shown.multipliers, radius: shown.radius, near: near?.y[0],
    command: `${withSlope(given.command, slope).replace("solve", "simulate")} --state ${state}`, step: flyStep(walker, start, slope) };
}

/** Keys of the walker of a map's cell. */
function keysOf(panel, values) {
  const keys = { ...panel.keys, ...values }, all = panel.axes ?? [panel.x, panel.y];
  for (const [key, [axes, list]] of Object.entries(panel.moved ?? {})) {
    const sides = axes.map(axis => all.find(side => side.name === axis));
    keys[key] = list[sides.reduce((k, side) => k * side.values.length + side.values.findIndex(value => value >= values[side.name] - 1e-12), 0)];
  }
  delete keys.slope;
  return keys;
}

// Maps: every cell holds the numbers of its gait, or the outcome of its motion. They stand in the page as the whole numbers
// by which they differ from a polynomial through their neighbours, most of them zero (figures/fields.py writes them).

const DIGITS = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ-_";
function readNumbers(text) {
  let at = 0;
  return () => {
    let value = 0, digit, by = 1;
    do { digit = DIGITS.indexOf(text[at++]); value += digit % 32 * by; by *= 32; } while (digit > 31);
    return value;
  };
}

/** Values of a field, row by row: numbers, or words that come in runs. */
function readField({ text, step, log, words }, [rows, columns]) {
  const next = readNumbers(text), values = new Float64Array(rows * columns);
  if (words) {
    const all = [];
    while (all.length < rows * columns) { const word = words[next()]; for (let run = next(); run >= 0; run--) all.push(word); }
    return all;
  }
  let zeros = 0, s = 1;
  const residual = () => {
    if (zeros) return zeros--, 0;
    const value = next();
    if (!value) return zeros = next(), 0;
    return value % 2 ? (value + 1) / 2 : -value / 2;
  };
  const predictor = (x, n) => {
    const known = ceil(n / (2 * s)), first = max(0, min(max(0, floor(x / (2 * s)) - 3), known - 8)), at = [];
    for (let j = first; j < min(first + 8, known); j++) at.push(2 * s * j);
    const weights = at.map(a => at.reduce((w, b) => b === a ? w : w * ((x - b) / (a - b)), 1));
    return get => floor(at.reduce((total, a, k) => total + get(a) * weights[k], 0) + 0.5);
  };
  while (8 * s < max(rows, columns)) s *= 2;
  for (let i = 0; i < rows; i += 2 * s) for (let j = 0; j < columns; j += 2 * s) values[i * columns + j] = (j ? values[i * columns + j - 2 * s] : i ? values[(i - 2 * s) * columns] : 0) + residual();
  for (; s >= 1; s /= 2) {
    for (let j = s; j < columns; j += 2 * s) { const by = predictor(j, columns); for (let i = 0; i < rows; i += 2 * s) values[i * columns + j] = by(a => values[i * columns + a]) + residual(); }
    for (let i = s; i < rows; i += 2 * s) { const by = predictor(i, rows); for (let j = 0; j < columns; j += s) values[i * columns + j] = by(a => values[a * columns + j]) + residual(); }
  }
  return values.map(v => log ? exp(v * step) : v * step);
}

/**
 * What a map holds of a cell: { at, slope, known, start, shown, command }, `known` whether it has a gait; without a start
 * where there is none, or where its state is not stored.
 */
function cellOf(map, [column, row]) {
  const { x, y, at: fixed, fields } = map, values = { [x.name]: x.values[column], [y.name]: y.values[row] };
  const field = name => {
    if (!(name in fields)) return undefined;
    map.read ??= {};
    map.read[name] ??= readField(fields[name], [y.values.length, x.values.length]);
    return map.read[name][row * x.values.length + column];
  };
  const known = field("present") !== false, digits = value => Number(value.toPrecision(9)), own = field("still") ? 0 : field("slope");
  const slope = values.slope ?? (own === undefined ? fixed.slope : digits(own)), at = { ...fixed, ...values }, angle = field("stance_angle");
  delete at.slope;
  const options = Object.entries(values).filter(([key]) => key !== "slope").map(([key, value]) => ` --set ${key}=${value}`).join("");
  const shown = map.shown.map(([name, key]) => [name, key in values ? values[key] : known ? key === "slope" ? slope : field(key) : "–"]);
  const start = known && angle !== undefined ? [angle, ...RATES.filter(name => name in fields).map(name => field(name) * angle)] : null;
  return { at, slope, known, start, shown, command: map.command + options };
}

/** Gait of a cell of a map; null where there is none. */
function gaitOfCell(map, cell) {
  const { at, slope, start, command } = cellOf(map, cell);
  return start && storedGait({ at, map, cell, keys: keysOf(map, at), slope, start, command });
}

/** The maps' cell that an address names, whose slope is the one given, if any: [map, cell]. */
const cellNamed = ({ at, slope, start }) => cellsAt(at, slope).find(([map, cell]) => {
  const own = cellOf(map, cell);
  return own.start && (isNaN(slope) && !start.length || hypot(rank(own.slope) - rank(slope), start.length && log(own.start[0] / start[0])) < 1e-6);
});
