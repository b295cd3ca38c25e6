"use strict";
// Hover: show the values of the nearest point of a figure and the command that reproduces them. Text only, no markup.
for (const plot of document.querySelectorAll(".plot")) {
  const data = plot.querySelector("script");
  if (!data) continue;
  const series = JSON.parse(data.textContent);
  const width = Number(plot.dataset.width), height = Number(plot.dataset.height);
  const dot = plot.appendChild(make("span", "dot")), tip = plot.appendChild(make("div", "tip"));
  tip.setAttribute("role", "status");
  let at = null, pinned = false;
  const buttons = [...plot.querySelectorAll(".legend button")];
  let chosen = null;
  // One line of a figure stands out: that of the point under the pointer, or the one chosen in the legend.
  function highlight(line) {
    if (!buttons.length) return;
    const shown = line ?? chosen;
    plot.classList.toggle("lit", shown !== null);
    for (const part of plot.querySelectorAll("svg [data-line]")) part.classList.toggle("on", Number(part.dataset.line) === shown);
  }
  for (const button of buttons) button.addEventListener("click", () => {
    const line = Number(button.dataset.line);
    chosen = chosen === line ? null : line;
    for (const other of buttons) other.setAttribute("aria-pressed", Number(other.dataset.line) === chosen);
    highlight(null);
  });
  hide();

  function make(tag, name, text) {
    const node = document.createElement(tag);
    if (name) node.className = name;
    if (text !== undefined) node.textContent = text;
    return node;
  }
  function hide() { highlight(null); dot.hidden = tip.hidden = true; at = null; pinned = false; tip.classList.remove("pinned"); }
  function nearest(event) {
    const box = plot.getBoundingClientRect(), scale = box.width / width;
    let best = null, least = 24;
    series.forEach((curve, s) => curve.rows.forEach((row, r) => {
      const distance = Math.hypot(row[0] * scale - event.clientX + box.left, row[1] * scale - event.clientY + box.top);
      if (distance < least) { least = distance; best = [s, r]; }
    }));
    return best;
  }
  function show([s, r]) {
    const curve = series[s], [x, y, more, ...values] = curve.rows[r];
    at = [s, r];
    highlight(curve.line ?? null);
    const list = make("dl");
    curve.names.forEach((name, i) => list.append(make("dt", "", name), make("dd", "", values[i])));
    tip.replaceChildren(make("b", "", curve.label), list);
    if (typeof more === "string") tip.append(make("code", "", more));
    else if (more !== null && curve.command) tip.append(make("code", "", curve.command + " --slope " + more));
    dot.hidden = tip.hidden = false;
    dot.style.left = 100 * x / width + "%";
    dot.style.top = 100 * y / height + "%";
    const scale = plot.clientWidth / width, wide = tip.offsetWidth, tall = tip.offsetHeight;
    tip.style.left = Math.max(0, Math.min(x * scale + 14, plot.clientWidth - wide)) + "px";
    tip.style.top = (y * scale > tall + 14 ? y * scale - tall - 14 : y * scale + 16) + "px";
  }
  plot.addEventListener("pointermove", event => {
    if (pinned) return;
    const point = nearest(event);
    if (point) show(point); else if (event.pointerType === "mouse") hide();
  });
  plot.addEventListener("pointerleave", () => { if (!pinned) hide(); });
  plot.addEventListener("click", event => {
    if (tip.contains(event.target) || event.target.closest(".legend")) return;
    const point = nearest(event);
    if (!point) return hide();
    show(point);
    pinned = true;
    tip.classList.add("pinned");
  });
  plot.addEventListener("blur", hide);
  plot.addEventListener("keydown", event => {
    const move = { ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowDown: [1, 0], ArrowUp: [-1, 0] }[event.key];
    if (event.key === "Escape") return hide();
    if (!move) return;
    event.preventDefault();
    if (!at) return show([0, 0]);
    const s = (at[0] + move[0] + series.length) % series.length;
    const last = series[s].rows.length - 1;
    show([s, Math.max(0, Math.min(last, at[1] + move[1]))]);
  });
}

// Animation of a walker on its slope, with its phase portrait.
for (const motion of document.querySelectorAll(".motion")) {
  const moves = JSON.parse(motion.querySelector("script").textContent);
  const walk = motion.querySelector(".walk"), phase = motion.querySelector(".phase");
  const button = name => motion.querySelector(`[data-do=${name}]`);
  const SECONDS = 1.1, SLOW = 6, HEIGHT = 300, WIDE = 560;
  let gait, time = 0, playing = false, slow = false, before = 0, parts;

  function draw(tag, parent, attributes) {
    const node = document.createElementNS(walk.namespaceURI, tag);
    for (const name in attributes) node.setAttribute(name, attributes[name]);
    return parent.appendChild(node);
  }
  function between(column, t) {
    const times = gait.time;
    let k = 1;
    while (k < times.length - 1 && times[k] < t) k++;
    const span = times[k] - times[k - 1] || 1, share = Math.min(1, Math.max(0, (t - times[k - 1]) / span));
    return column[k - 1] + share * (column[k] - column[k - 1]);
  }
  const turn = (angle, length) => [length * Math.sin(angle), -length * Math.cos(angle)];
  const add = (a, b) => [a[0] + b[0], a[1] + b[1]];

  function pose(total) {
    const [thigh, shank, radius, epsT, epsS, length] = gait.body;
    const period = gait.time[gait.time.length - 1], step = Math.floor(total / period), t = total - step * period;
    const [st, th, sh] = gait.angles.map(column => between(column, t));
    const centre = [step * gait.step - radius * st, radius];
    const hip = add(centre, turn(st, -length));
    const leg = (upper, lower) => {
      const knee = add(hip, turn(upper - epsT, thigh)), foot = add(knee, turn(lower + epsS, shank));
      const toe = k => add(foot, turn(lower + k, radius));
      return { line: [hip, knee, add(foot, turn(lower + epsS, radius))], sole: [-.5, -.25, 0, .25, .5].map(toe) };
    };
    const stance = leg(st, st), swing = leg(th, sh), rates = gait.rates.map(column => between(column, t));
    const heavy = step % 2 ? { leg: swing, angle: th, rate: rates[1] } : { leg: stance, angle: st, rate: rates[0] };
    return { hip, heavy, light: step % 2 ? stance : swing, period };
  }
  function path(points, place) {
    return points.map((p, i) => (i ? "L" : "M") + place(p).map(v => v.toFixed(1)).join(" ")).join("");
  }
  function choose(k) {
    gait = moves[k];
    time = 0;
    walk.replaceChildren();
    phase.replaceChildren();
    motion.querySelector(".command code").textContent = gait.command;
    const colour = `var(--${gait.gait})`, world = draw("g", walk, {});
    const leg = (ink, width) => draw("path", world, { fill: "none", stroke: ink, "stroke-width": width, "stroke-linecap": "round", "stroke-linejoin": "round" });
    parts = { world, ground: draw("path", world, { stroke: "var(--muted)", "stroke-width": 1.2 }),
      trail: draw("path", world, { fill: "none", stroke: "var(--muted)", "stroke-width": 1, "stroke-dasharray": "1 4", "stroke-linecap": "round" }),
      light: leg("var(--ink)", 2.2), heavy: leg(colour, 4.5), hip: draw("circle", world, { r: 5, fill: "var(--ink)" }) };
    portrait(colour);
    frame();
  }
  function portrait(colour) {
    const [st, th] = gait.angles, [dst, dth] = gait.rates;
    const first = st.map((v, i) => [v, dst[i]]), second = th.map((v, i) => [v, dth[i]]), all = [...first, ...second];
    const ends = i => [Math.min(...all.map(p => p[i])), Math.max(...all.map(p => p[i]))];
    const [[left, right], [low, high]] = [ends(0), ends(1)];
    const place = p => [34 + 240 * (p[0] - left) / (right - left || 1), 255 - 215 * (p[1] - low) / (high - low || 1)];
    const [x0, y0] = place([0, 0]);
    draw("path", phase, { d: `M26 ${y0}H284M${x0} 32V264`, stroke: "var(--rule)", "stroke-width": 1 });
    const curve = (points, more) => draw("path", phase, { d: path(points, place), fill: "none", stroke: colour, "stroke-width": 2, ...more });
    curve(first); curve(second);
    const jump = { "stroke-dasharray": "2 3", "stroke-width": 1.2 };
    curve([first[first.length - 1], second[0]], jump); curve([second[second.length - 1], first[0]], jump);
    const say = (x, y, text, anchor) => {
      draw("text", phase, { x, y, "font-size": 13, fill: "var(--muted)", "text-anchor": anchor }).textContent = text;
    };
    say(26, 20, "angular rate of the leg", "start");
    say(284, 290, "angle of the leg", "end");
    parts.dot = draw("circle", phase, { r: 5.5, fill: colour, stroke: "var(--wash)", "stroke-width": 1.5 });
    parts.place = place;
  }
  function frame() {
    const current = pose(time), leg = gait.body[5] + gait.body[2], scale = 225 / leg, reach = WIDE / scale;
    // The camera moves at the walker's mean speed.
    const camera = time / current.period * gait.step;
    const place = p => [WIDE / 2 + (p[0] - camera) * scale, 262 - p[1] * scale];
    parts.world.setAttribute("transform", `rotate(${gait.slope * 180 / Math.PI} ${WIDE / 2} 262)`);
    let ground = path([[camera - reach, 0], [camera + reach, 0]], place);
    for (let k = Math.floor((camera - reach) / gait.step); k * gait.step < camera + reach; k++)
      ground += path([[k * gait.step, 0], [k * gait.step, -.035 * leg]], place);
    parts.ground.setAttribute("d", ground);
    const past = [];
    for (let t = Math.max(0, time - 2 * current.period); t < time; t += current.period / 14) past.push(pose(t).hip);
    parts.trail.setAttribute("d", past.length > 1 ? path(past, place) : "");
    for (const [node, limb] of [[parts.light, current.light], [parts.heavy, current.heavy.leg]])
      node.setAttribute("d", path(limb.line, place) + path(limb.sole, place));
    const [hx, hy] = place(current.hip), [px, py] = parts.place([current.heavy.angle, current.heavy.rate]);
    parts.hip.setAttribute("cx", hx); parts.hip.setAttribute("cy", hy);
    parts.dot.setAttribute("cx", px); parts.dot.setAttribute("cy", py);
  }
  function tick(stamp) {
    if (!playing) return;
    const passed = Math.min(.1, (stamp - (before || stamp)) / 1000);
    before = stamp;
    time += passed * gait.time[gait.time.length - 1] / (slow ? SLOW : SECONDS);
    frame();
    requestAnimationFrame(tick);
  }
  function play(on) {
    playing = on;
    before = 0;
    button("play").textContent = on ? "Pause" : "Play";
    button("play").setAttribute("aria-pressed", on);
    if (on) requestAnimationFrame(tick);
  }
  button("play").addEventListener("click", () => play(!playing));
  button("slow").addEventListener("click", () => { slow = !slow; button("slow").setAttribute("aria-pressed", slow); });
  button("step").addEventListener("click", () => { play(false); time += gait.time[gait.time.length - 1] / 24; frame(); });
  motion.querySelector("select")?.addEventListener("change", event => choose(Number(event.target.value)));
  choose(0);
}

// Tables: a click on a heading sorts the rows.
for (const table of document.querySelectorAll("table.archive")) {
  const body = table.tBodies[0];
  if (!body || body.rows.length < 3) continue;
  const exact = cell => { const data = cell.querySelector("data"); return data ? Number(data.value) : NaN; };
  [...table.tHead.rows[0].cells].forEach((head, k) => {
    if (!head.textContent.trim()) return;
    const button = document.createElement("button");
    button.type = "button"; button.className = "sort";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const rows = [...body.rows].map(row => [exact(row.cells[k]), row.cells[k].textContent, row]);
      rows.sort((a, b) => isNaN(a[0]) || isNaN(b[0]) ? a[1].localeCompare(b[1]) || 0 : a[0] - b[0]);
      if (down) rows.reverse();
      body.append(...rows.map(row => row[2]));
    });
  });
}

// Ledger: filter by words and verdict.
for (const form of document.querySelectorAll(".filter")) {
  form.hidden = false;
  const claims = [...document.querySelectorAll(".claim")], said = form.querySelector("[role=status]");
  const apply = () => {
    const words = form.elements.words.value.toLowerCase().split(/\s+/).filter(Boolean), verdict = form.elements.verdict.value;
    let count = 0;
    for (const claim of claims) {
      const text = claim.textContent.toLowerCase();
      claim.hidden = !(words.every(word => text.includes(word)) && (!verdict || claim.dataset.verdict === verdict));
      count += !claim.hidden;
    }
    for (const family of document.querySelectorAll(".family")) family.hidden = !family.querySelector(".claim:not([hidden])");
    said.textContent = words.length || verdict ? `${count} of ${claims.length} claims` : "";
  };
  for (const event of ["input", "change"]) form.addEventListener(event, apply);
  form.addEventListener("submit", event => event.preventDefault());
}

addEventListener("beforeprint", () => document.querySelectorAll("details").forEach(details => { details.open = true; }));
