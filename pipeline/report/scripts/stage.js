// Motions in time and their pictures: the walker on its slope, its phase portrait, its multipliers in the unit circle.

const PICTURES = document.querySelector("svg")?.namespaceURI;
const DEGREES = 180 / Math.PI;
/** Whether a key is the browser's own, with another pressed: back, or the size of the page. */
const isBrowsers = event => event.ctrlKey || event.metaKey || event.altKey;
/** Rows down and columns to the right that a key moves by. */
const ARROWS = { ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowDown: [1, 0], ArrowUp: [-1, 0] };
const nodesOf = selector => document.querySelectorAll(selector);
const on = (target, event, act) => target.addEventListener(event, act);
function set(node, attributes) {
  for (const name in attributes) node.setAttribute(name, attributes[name]);
}
function draw(tag, parent, attributes, text) {
  const node = document.createElementNS(PICTURES, tag);
  set(node, attributes);
  if (text !== undefined) node.textContent = text;
  return parent.appendChild(node);
}
const write = (svg, x, y, text, anchor = "start", turn = 0) => draw("text", svg, { x, y, "font-size": 12, fill: "var(--muted)", "text-anchor": anchor, transform: `rotate(${turn} ${x} ${y})` }, text);
function make(tag, name, text) {
  const node = document.createElement(tag);
  if (name) node.className = name;
  if (tag === "button") node.type = tag;
  if (text !== undefined) node.textContent = text;
  return node;
}
const minusSign = text => text.replace(/-/g, "−");
const brief = (value, digits = 4) => !isFinite(value) ? "–" : minusSign(abs(value) >= 1e-4 && abs(value) < 1e5 || !value ? String(Number(value.toPrecision(digits))) : Number(value.toPrecision(digits)).toExponential());

/** A step of one, two or five times a power of ten, no less than a length. */
const niceStep = rough => { const ten = 10 ** floor(Math.log10(rough)); return ten * [1, 2, 5, 10].find(n => n * ten >= rough * 0.999); };

/** State of a phase at a time: its cubic Hermite polynomial between two samples. */
function sampleAt({ samples }, t) {
  let low = 0, high = samples.length - 1;
  while (high - low > 1) { const middle = (low + high) >> 1; if (samples[middle][0] <= t) low = middle; else high = middle; }
  const [t0, x0, d0] = samples[low], [t1, x1, d1] = samples[high], h = t1 - t0;
  if (!(h > 0)) return x1;
  const s = min(1, max(0, (t - t0) / h)), a = (2 * s - 3) * s * s + 1, b = ((s - 2) * s + 1) * s * h, c = (3 - 2 * s) * s * s, d = (s - 1) * s * s * h;
  return x0.map((v, i) => a * v + b * d0[i] + c * x1[i] + d * d1[i]);
}

const durationOf = step => step.phases[step.phases.length - 1].samples.at(-1)[0];

/**
 * A motion: steps one after the other. That of a gait repeats its solved step without end, for an unstable one would
 * drift away; any other goes on freely until the walker falls, and its steps are computed as they are needed.
 */
class Motion {
  constructor(gait, most = 200) {
    Object.assign(this, { walker: gait.walker, slope: gait.slope, most, repeats: !gait.free });
    this.steps = [gait.step];
    this.begins = [0];
    this.feet = [0];
  }
  advance(count) {
    while (!this.repeats && this.steps.length <= count && this.steps.length < this.most) {
      const last = this.steps.at(-1);
      if (last.fall) return;
      this.begins.push(this.begins.at(-1) + last.period);
      this.feet.push(this.feet.at(-1) + this.stride(last));
      this.steps.push(flyStep(this.walker, last.end, this.slope));
    }
  }
  stride(step) { return 2 * (this.walker.l * sin(step.end[0]) + this.walker.R * step.end[0]); }
  /** Which step a time falls into, the time within it and where its foot stands. */
  at(time) {
    const first = this.steps[0];
    if (this.repeats) {
      const k = floor(time / first.period);
      return { k, step: first, t: time - k * first.period, foot: k * this.stride(first) };
    }
    while (time > this.begins.at(-1) + durationOf(this.steps.at(-1)) && this.steps.length < this.most && !this.steps.at(-1).fall) this.advance(this.steps.length);
    let k = this.steps.length - 1;
    while (k > 0 && this.begins[k] > time) k--;
    return { k, step: this.steps[k], t: min(time - this.begins[k], durationOf(this.steps[k])), foot: this.feet[k] };
  }
  /** Time at which the motion ends; endless motions end never. */
  get end() { return this.repeats ? Infinity : this.begins.at(-1) + durationOf(this.steps.at(-1)); }
  get speed() { return this.repeats ? this.stride(this.steps[0]) / this.steps[0].period : 0; }
  /** The motion changed at a time by adding to the rates of stance leg and swing leg; it goes on freely. */
  pushed(time, change) {
    const { k, step, t, foot } = this.at(time);
    if (step.fall) return this;
    const phase = step.phases.find(part => t <= part.samples.at(-1)[0]) ?? step.phases.at(-1), x = vector(sampleAt(phase, t)), n = x.length / 2;
    x[n] += change[0];
    for (let i = n + 1; i < 2 * n; i++) x[i] += change[1];
    const before = step.phases.filter(part => part.samples.at(-1)[0] < t || part === phase)
      .map(part => ({ samples: part.samples.filter(([moment]) => moment < t) })).filter(part => part.samples.length);
    const rest = flyStep(this.walker, x, this.slope, t), joined = { ...rest, phases: [...before, ...rest.phases], kneestrike: rest.kneestrike ?? step.kneestrike };
    return Object.assign(Object.create(Motion.prototype), this, { repeats: false, steps: [joined], begins: [time - t], feet: [foot], push: time, number: (this.number ?? 0) + k });
  }
}

/** Places of hip, knees and feet, from the state of a step; `foot` is where the stance foot stands. */
function pose(walker, { step, t, foot }) {
  const phase = step.phases.find(part => t <= part.samples.at(-1)[0]) ?? step.phases.at(-1), x = sampleAt(phase, t), n = x.length / 2;
  const angles = [x[0], x[1], x[n - 1]], rates = [x[n], x[n + 1], x[2 * n - 1]], { R, l } = walker;
  const centre = [foot - R * angles[0], R], hip = plus(centre, [-l * sin(angles[0]), l * cos(angles[0])]);
  const leg = (upper, lower) => {
    const knee = plus(hip, turned(walker.knee, upper)), end = plus(knee, turned(walker.foot, lower)), down = angle => plus(end, [R * sin(angle), -R * cos(angle)]);
    return { line: [hip, knee, down(lower)], sole: R ? [-.45, -.22, 0, .22, .45].map(k => down(lower + k)) : [end] };
  };
  return { hip, stance: leg(angles[0], angles[0]), swing: leg(angles[1], angles[2]), angles, rates };
}

const STAGE = { width: 640, height: 300, floor: 258, tall: 205 };
const pathOf = (points, place) => points.map((p, i) => (i ? "L" : "M") + place(p).map(v => v.toFixed(1)).join(" ")).join("");

/** The picture of one or two walkers on their slope; `show(actors, time)` draws it anew. */
function makeStage(svg) {
  svg.replaceChildren();
  const world = draw("g", svg, {}), ground = draw("path", world, { stroke: "var(--muted)", "stroke-width": 1.2, fill: "none" });
  const trail = draw("path", world, { fill: "none", stroke: "var(--muted)", "stroke-dasharray": "1 4", "stroke-linecap": "round" });
  const said = draw("text", svg, { x: STAGE.width / 2, y: 26, "text-anchor": "middle", "font-size": 15, fill: "var(--muted)" });
  const incline = draw("text", svg, { class: "incline", x: STAGE.width - 8, y: 26, "text-anchor": "end", "font-size": 15, fill: "var(--muted)" });
  const actors = [0, 1].map(second => {
    const group = draw("g", world, second ? { opacity: 0.55 } : {}), dashes = second ? "7 4" : "none";
    const leg = (ink, width) => draw("path", group, { fill: "none", stroke: ink, "stroke-width": width, "stroke-linecap": "round", "stroke-linejoin": "round", "stroke-dasharray": dashes });
    return { group, light: leg("var(--ink)", 2.2), heavy: leg("var(--line0)", 4.5), hip: draw("circle", group, { r: 5, fill: "var(--ink)" }), spark: draw("circle", group, { r: 9, fill: "none", stroke: "var(--bad)", "stroke-width": 2.5 }) };
  });
  let scale = STAGE.tall;
  return { show(motions, time) {
    let word = "";
    actors.forEach((actor, number) => {
      actor.group.style.display = motions[number] ? "" : "none";
      if (!motions[number]) return;
      const { motion, ink } = motions[number], { walker } = motion, now = motion.at(time), current = pose(walker, now);
      // The camera moves at the walker's mean speed, or, where there is none, with its hip.
      const camera = motion.repeats ? time * motion.speed : current.hip[0];
      const place = p => [STAGE.width / 2 + (p[0] - camera) * scale, STAGE.floor - p[1] * scale];
      const odd = (now.k + (motion.number ?? 0)) % 2, legs = odd ? [current.swing, current.stance] : [current.stance, current.swing];
      set(actor.heavy, { stroke: ink });
      [actor.heavy, actor.light].forEach((node, i) => set(node, { d: pathOf(legs[i].line, place) + pathOf(legs[i].sole, place) }));
      const [cx, cy] = place(current.hip);
      set(actor.hip, { cx, cy });
      // A strike is marked for a little while where it happens.
      const flash = 0.16, struck = now.t < flash && now.k > 0 ? ["heelstrike", place(current.stance.line[2])]
        : now.step.kneestrike !== null && now.t >= now.step.kneestrike && now.t < now.step.kneestrike + flash ? ["kneestrike", place(current.swing.line[1])] : null;
      actor.spark.style.display = struck ? "" : "none";
      if (struck) { set(actor.spark, { cx: struck[1][0], cy: struck[1][1] }); }
      if (number) return;
      word = now.step.fall && now.t >= durationOf(now.step) - 1e-9 ? FALLS[now.step.fall] : struck ? struck[0] : "";
      set(world, { transform: `rotate(${motion.slope * DEGREES} ${STAGE.width / 2} ${STAGE.floor})` });
      const reach = STAGE.width / scale, gap = motion.repeats ? motion.stride(motion.steps[0]) : 0.25, every = gap * scale < 14 ? ceil(14 / (gap * scale)) * gap : gap;
      let d = pathOf([[camera - reach, 0], [camera + reach, 0]], place);
      for (let k = floor((camera - reach) / every); k * every < camera + reach; k++) d += pathOf([[k * every, 0], [k * every, -.035]], place);
      set(ground, { d });
      const past = [], beat = (motion.steps[0].period ?? 3) / 14;
      for (let s = max(motion.begins[0], time - 28 * beat); s < time; s += beat) past.push(pose(walker, motion.at(s)).hip);
      set(trail, { d: past.length > 1 ? pathOf(past, place) : "" });
      incline.textContent = `γ = ${brief(motion.slope, 3)} rad = ${brief(motion.slope * DEGREES, 3)}°`;
    });
    said.textContent = word;
  } };
}

/** The multipliers of a gait, and of another, in the unit circle. */
function drawCircle(svg, gaits) {
  svg.replaceChildren();
  const centre = 110, unit = 78, add = (tag, attributes, text) => draw(tag, svg, attributes, text);
  add("path", { d: `M12 ${centre}H208M${centre} 12V208`, stroke: "var(--rule)" });
  add("circle", { cx: centre, cy: centre, r: unit, fill: "none", stroke: "var(--muted)", "stroke-width": 1.5 });
  const say = (...words) => write(svg, ...words);
  say(8, 14, "multipliers λ");
  say(212, centre + 30, "Re", "end");
  say(centre + 5, 24, "Im");
  for (const v of [-1, 1]) { say(centre + v * (unit + 3), centre + 14, minusSign(String(v)), v < 0 ? "end" : "start"); say(centre + 5, centre - v * (unit + 7) + 5, v < 0 ? "−i" : "i"); }
  for (const { gait, ink, second } of gaits) for (const [re, im] of gait.multipliers ?? []) {
    const size = hypot(re, im), far = size > 1.28, [x, y] = far ? [re / size * 1.28, im / size * 1.28] : [re, im], at = { cx: centre + unit * x, cy: centre - unit * y };
    add("circle", { ...at, r: 5.5, fill: second ? "none" : ink, stroke: ink, "stroke-width": second ? 2 : 1, "data-multiplier": `${re} ${im}` });
    if (far) add("text", { x: at.cx + (x < 0 ? 10 : -10), y: at.cy + (second ? 30 : -12), "text-anchor": x < 0 ? "start" : "end", "font-size": 13, fill: ink }, `${minusSign(re.toPrecision(3))}${im ? (im < 0 ? " − " : " + ") + abs(im).toPrecision(3) + "i" : ""} ${x < 0 ? "←" : "→"}`);
  }
}

/** The phase portrait of a motion's steps: rate against angle of both legs. `place` puts a point of it on the picture. */
function drawPortrait(svg, motion, ink, time, unit) {
  svg.replaceChildren();
  const curves = motion.steps.slice(0, 12).map(step => [0, 1].map(leg => step.phases.flatMap(({ samples }) => samples.map(([, x]) => [x[leg], x[x.length / 2 + leg]]))));
  const all = curves.flat(2), ends = i => [min(...all.map(p => p[i])), max(...all.map(p => p[i]))], [[left, right], [low, high]] = [ends(0), ends(1)];
  const place = p => [18 + 184 * (p[0] - left) / (right - left || 1), 190 - 158 * (p[1] - low) / (high - low || 1)], [x0, y0] = place([0, 0]);
  draw("path", svg, { d: `M12 ${y0}H208M${x0} 26V196`, stroke: "var(--rule)" });
  for (const pair of curves) for (const points of pair) draw("path", svg, { d: pathOf(points, place), fill: "none", stroke: ink, "stroke-width": curves.length > 1 ? 1 : 1.8 });
  const say = (...words) => write(svg, ...words);
  say(8, 14, `rate of the legs (rad/${unit})`);
  say(212, 216, "angle (rad)", "end");
  // Ticks along the axes: rates in the units of time that are shown.
  const ticks = (from, to) => { const step = niceStep((to - from) / 3), all = []; for (let n = ceil(from / step); n * step <= to; n++) if (n) all.push(n * step); return all; };
  for (const v of ticks(left, right)) { const [x] = place([v, 0]); draw("path", svg, { d: `M${x} ${y0 - 3}v6`, stroke: "var(--muted)" }); say(x, 203, brief(v, 2), "middle"); }
  for (const v of ticks(low / time, high / time)) { const [, y] = place([0, v * time]); draw("path", svg, { d: `M${x0 - 3} ${y}h6`, stroke: "var(--muted)" }); say(x0 + 8, y + 4, brief(v, 2)); }
  const dot = draw("circle", svg, { r: 5, fill: ink, stroke: "var(--wash)", "stroke-width": 1.5 });
  return point => { const [cx, cy] = place(point); set(dot, { cx, cy }); };
}
