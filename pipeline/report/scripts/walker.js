// The walking panel of a page: the gait selected, in motion beside its multipliers, losses, violations and command; a
// slider along its branch, pushes, a second gait at the same slope. Its selection is the page's, and stands in the address.

const EARTH = 9.81 ** -0.5, STILL = matchMedia("(prefers-reduced-motion: reduce)");
const panel = document.querySelector(".motion");

/** Select what an address, a mark, a cell or a row names; the page's figures and tables hear of it by the event `gait`. */
let select = () => {};
/** What walks at first on a page whose lines have no branches: a dot of an orbit, or a cell of a map. */
let lead;

function tellPage(gait) { document.dispatchEvent(new CustomEvent("gait", { detail: gait })); }

if (panel && LINES.length + nodesOf("script.panels").length) {
  panel.hidden = false;
  const find = name => panel.querySelector(`[data-part=${name}]`), button = name => panel.querySelector(`[data-do=${name}]`);
  const stage = makeStage(find("walk"));
  let gait = null, motion = null, other = null, second = null, spot = () => {}, time = 0, playing = false, before = 0, drawn = 0, docked = false;

  const realTime = () => gait.walker.keys.units === "SI" ? gait.walker.time : EARTH;
  const inkOf = ({ line, map }) => `var(--${(line ?? map)?.ink ?? "line0"})`;
  const say = text => { find("said").textContent = text; };
  const units = () => find("units").value === "own" && gait.walker.keys.units === "SI"
    ? { time: gait.walker.time, s: "s", speed: gait.walker.speed, v: "m/s", energy: gait.walker.energy, E: "J", length: gait.walker.leg, l: "m" }
    : { time: 1, s: "√(leg/g)", speed: 1, v: "√(g leg)", energy: 1, E: "m g leg", length: 1, l: "leg" };

  function frame() {
    const end = motion.end;
    if (time > end) { time = end; if (playing) play(false); }
    const now = motion.at(time), both = [{ motion, ink: inkOf(gait) }];
    if (second) both.push({ motion: second, ink: inkOf(other) });
    stage.show(both, time);
    const current = pose(motion.walker, now), odd = (now.k + (motion.number ?? 0)) % 2;
    spot([current.angles[odd], current.rates[odd]]);
    const { time: unit, s } = units(), scrub = find("scrub"), whole = durationOf(now.step);
    scrub.value = whole ? now.t / whole : 0;
    const number = (motion.number ?? 0) + now.k + 1;
    scrub.ariaValueText = `${brief(now.t * unit, 3)} ${s} of step ${number}`;
    find("clock").textContent = `step ${number}, ${minusSign((now.t * unit).toFixed(2))} of ${(whole * unit).toFixed(2)} ${s}`;
    const knee = now.step.kneestrike;
    find("strike").hidden = !knee;
    if (knee) find("strike").style.left = `${100 * knee / whole}%`;
  }
  function tick(stamp) {
    if (!playing) return;
    const passed = min(0.1, (stamp - (before || stamp)) / 1000);
    before = stamp;
    drawn++;
    panel.dataset.frames = drawn;
    time += passed / realTime() / Number(find("pace").value);
    frame();
    requestAnimationFrame(tick);
  }
  function play(on) {
    if (on && !playing) requestAnimationFrame(tick);
    if (on && time >= motion.end) time = motion.begins[0];
    playing = on;
    before = 0;
    button("play").textContent = on ? "Pause" : "Play";
    button("play").ariaPressed = on;
  }
  function dock(on) {
    docked = on;
    panel.classList.toggle("docked", on);
    button("close").hidden = !on;
    document.body.classList.toggle("beside", on);
    document.body.style.setProperty("--panel", `${panel.offsetHeight}px`);
    dispatchEvent(new Event("resize"));
  }

  const row = (name, value, unit) => { const dd = make("dd", "", value); if (unit) dd.append(" ", make("span", "unit", unit)); return [make("dt", "", name), dd]; };
  function facts() {
    find("units").parentElement.hidden = gait.walker.keys.units !== "SI";
    const u = units(), list = make("dl"), { walker, step } = gait, angle = gait.start[0];
    list.append(...[["slope γ", gait.slope], ["stance angle θ*", angle]].flatMap(([name, x]) => row(name, brief(x, 6), `rad = ${brief(x * DEGREES, 4)}°`)));
    if (!step.fall) {
      const length = motion.stride(step);
      list.append(...row("period T", brief(step.period * u.time, 6), u.s), ...row("step length", brief(length * u.length, 4), u.l), ...row("mean speed", brief(length / step.period * u.speed, 4), u.v));
    }
    if (gait.radius !== undefined) {
      const off = gait.radius - 1;
      list.append(...row(gait.free ? "gait nearby, max |λ|" : "max |λ|", abs(off) < 1e-4 ? `1 ${off < 0 ? "−" : "+"} ${brief(abs(off), 2)}` : brief(gait.radius, 5), off < 0 ? "stable" : "unstable"));
    }
    find("facts").replaceChildren(list);
    const shares = find("losses");
    shares.replaceChildren();
    if (gait.losses) {
      const { normal, tangential, kneestrike } = gait.losses, total = normal + tangential + kneestrike;
      shares.append(make("b", "", `Energy lost per step: ${brief(total * u.energy, 4)} ${u.E}`));
      for (const [name, loss] of [["heelstrike, normal", normal], ["heelstrike, tangential", tangential], ...(walker.kneed ? [["kneestrike", kneestrike]] : [])]) {
        const line = make("p", "share"), bar = make("i");
        bar.style.width = `${100 * loss / total}%`;
        line.append(make("span", "", name), bar, make("span", "unit", `${(100 * loss / total).toFixed(1)} %`));
        shares.append(line);
      }
    }
    const broken = find("violations");
    broken.replaceChildren();
    if (gait.violations) broken.append(make("b", "", gait.violations.length ? "Assumption violated: " : "No assumption violated"), gait.violations.join(", "));
    find("command").textContent = gait.command ?? "";
  }

  /** Show that there is no gait: nothing goes on under the title of another. */
  function clear() {
    if (gait) play(false);
    panel.classList.add("empty");
    find("title").textContent = "No gait";
    address();
    tellPage(null);
  }

  /** Write the address of what is shown: browsers refuse too many in a time, the last of which then follows. */
  function address() {
    try {
      history.replaceState(null, "", panel.classList.contains("empty") ? location.pathname + location.search : writeAddress(gait));
    } catch {
      setTimeout(address, 999);
    }
  }

  /** Show a gait found, or a motion from any state. */
  function show(next, { write = true, keep = false } = {}) {
    panel.classList.remove("empty");
    const share = keep && motion && gait ? motion.at(time).t / durationOf(motion.at(time).step) : 0;
    panel.hidden = false;
    gait = next;
    motion = new Motion(gait);
    time = share * durationOf(motion.steps[0]);
    other = second = null;
    facts();
    find("title").textContent = gait.free ? `A motion of ${nameOf(gait)}` : `${gait.label[0].toUpperCase()}${gait.label.slice(1)}-step gait of ${nameOf(gait)}`;
    portrait();
    circle();
    slider();
    keySliders();
    outcome();
    companions();
    frame();
    if (write) address();
    tellPage(gait);
  }
  const nameOf = ({ at, line }) => line?.called && line.called !== at.walker ? `walker ${line.called} (${at.walker} with ${setOf(at)})` : [at.walker?.length > 1 ? `the ${at.walker} walker` : `walker ${at.walker}`, setOf(at)].filter(Boolean).join(", ");
  const setOf = at => Object.entries(at).filter(([key]) => key !== "walker" && key !== "slope").map(([key, value]) => `${key === "foot_mass_ratio" ? "ρ" : key} = ${brief(value, 5)}`).join(", ");
  const portrait = () => { const { time: one, s } = units(); spot = drawPortrait(find("phase"), motion, inkOf(gait), one, s); };
  const circle = () => drawCircle(find("circle"), [...(other ? [{ gait: other, ink: inkOf(other), second: true }] : []), { gait, ink: inkOf(gait) }]);

  // Along the branch: every place between two nodes is a gait, found anew.
  function slider() {
    const nodes = gait.line?.branches?.[gait.branch] ?? [], range = find("slide");
    if (find("along").hidden = nodes.length < 2) return;
    range.max = nodes.length - 1;
    range.step = (nodes.length - 1) / 1000;
    if (document.activeElement !== range || abs(range.value - gait.place) > 1) range.value = gait.place;
    range.ariaValueText = `slope ${brief(gait.slope, 5)}, stance angle ${brief(gait.start[0], 5)}, ${gait.radius < 1 ? "stable" : "unstable"}`;
  }
  let wanted = null;
  function slideTo(place) {
    if (wanted === null) requestAnimationFrame(() => {
      const nodes = gait.line.branches[gait.branch], found = gaitAt(gait.line, gait.branch, min(nodes.length - 1, max(0, wanted)));
      wanted = null;
      if (found) { say(""); show(found, { keep: true }); } else say("No gait was found at this place of the branch.");
    });
    wanted = place;
  }

  // Sliders over keys: cells of a map, or lines that differ in one key. What walks is always an archived gait.
  function sidesOf({ map, cell, line, at, slope, start, free, label }) {
    if (map) return map.free ? [] : [map.x, map.y].map((side, k) => {
      const wish = i => ({ map, cell: cell.map((old, j) => j === k ? i : old) });
      return { ...side, at: cell[k], wish, angle: i => cellOf(map, wish(i).cell).start?.[0] };
    });
    const family = LINES.filter(one => one.branches.length && one.at.walker === at.walker), name = Object.keys(at).filter(key => key !== "walker" && new Set(family.map(one => one.at[key])).size > 1);
    if (free || !line || name.length !== 1) return [];
    const lines = family.sort((a, b) => a.at[name] - b.at[name]), up = label === "long" ? 1 : -1;
    // Of another line the gait of nearly that slope whose angle is the larger, or the smaller, as the label says.
    const far = node => 4 * abs(rank(node[0]) - rank(slope)) - up * max(-1, min(1, log(node[1] / start[0])));
    const nodes = lines.map(one => one.branches.flat().reduce((best, node) => far(node) < far(best) ? node : best));
    return [{ name: name[0], values: lines.map(one => one.at[name]), at: lines.indexOf(line), angle: i => nodes[i][1], wish: i => ({ at: lines[i].at, slope: nodes[i][0], start: nodes[i].slice(1) }) }];
  }
  let moved = 0;
  function keySliders() {
    const sides = sidesOf(gait), box = find("keys"), names = sides.map(side => side.name).join();
    if (box.dataset.names !== names) {
      box.dataset.names = names;
      moved = 0;
      box.replaceChildren(...sides.map(() => { const label = make("label"), range = make("input"); range.type = "range"; label.append(make("span"), " ", range); return label; }));
    }
    sides.forEach((side, k) => {
      const [label, range] = box.children[k].children;
      label.textContent = `${side.name} = ${brief(side.values[side.at], 4)}`;
      range.max = side.values.length - 1;
      range.value = side.at;
      range.oninput = () => { moved = k; select(side.wish(Number(range.value)), { keep: true }); };
    });
    alongKey(sides[moved]);
  }
  /** Stance angles of the archived gaits along a key. */
  function alongKey(side) {
    const chart = find("curve"), found = side ? side.values.map((value, i) => [side.log ? log(value) : value, side.angle(i), i]).filter(([, angle]) => angle > 0) : [];
    const ends = k => { const all = found.map(dot => dot[k]); return [min(...all), max(...all)]; }, [[left, right], [low, high]] = [ends(0), ends(1)];
    chart.replaceChildren();
    chart.style.display = found[3] ? "" : "none";
    find("fit").textContent = found[3] ? `dots: θ* along ${side.name}` : "";
    for (const [x, y, i] of found) draw("circle", chart, { cx: 6 + 228 * (x - left) / (right - left || 1), cy: 52 - 44 * (y - low) / (high - low || 1), ...i === side.at ? { r: 4.5, fill: inkOf(gait) } : { r: 1.3, fill: "var(--muted)" } });
  }

  // A second gait of the line at the same slope, beside the first.
  function companions() {
    const chooser = find("second");
    chooser.replaceChildren(new Option("none", ""));
    find("beside").hidden = true;
    if (!gait.line?.branches?.length || gait.free) return;
    const place = gait;
    setTimeout(() => {
      if (gait !== place) return;
      const found = gaitsAt(gait.line, gait.slope).filter(item => abs(item.start[0] / gait.start[0] - 1) > 1e-5);
      found.forEach((item, k) => chooser.append(new Option(`${item.label}, θ* = ${brief(item.start[0], 4)}${item.radius < 1 ? ", stable" : ""}`, k)));
      chooser.onchange = () => {
        other = found[chooser.value] ?? null;
        second = other && new Motion(other);
        circle();
        frame();
      };
      find("beside").hidden = !found.length;
    }, 60);
  }

  // A push changes the rates of both legs by a share of the stance rate; then the walker is simulated freely.
  function push(sign) {
    if (time >= motion.end) show(gait);  // what has fallen begins again
    const n = gait.start.length / 2, size = sign * Number(find("strength").value) * abs(gait.start[n]);
    motion = motion.pushed(time, [-size, -size]);
    second = null;
    outcome();
    portrait();
    if (!playing && !STILL.matches) play(true);
    frame();
  }
  /** What becomes of a free motion: the stance angles of its steps, and in words. */
  function outcome() {
    const chart = find("chart"), text = find("outcome");
    chart.replaceChildren();
    text.textContent = "";
    button("reset").hidden = motion.repeats || gait.free;
    chart.style.display = motion.repeats ? "none" : "";
    if (motion.repeats) return;
    motion.advance(60);
    const walked = motion.steps.filter(step => !step.fall), last = motion.steps.at(-1), angles = walked.map(step => step.end[0]), aim = gait.free ? gait.near : gait.start[0];
    const low = min(...angles, aim ?? Infinity, gait.start[0]), high = max(...angles, aim ?? 0, gait.start[0]), y = value => 52 - 44 * (value - low) / (high - low || 1);
    const x = k => 6 + 228 * k / max(12, angles.length);
    if (aim) draw("path", chart, { d: `M4 ${y(aim)}H236`, stroke: "var(--muted)", "stroke-dasharray": "3 3" });
    angles.forEach((angle, k) => draw("circle", chart, { cx: x(k + 1), cy: y(angle), r: 2.4, fill: inkOf(gait) }));
    if (last.fall) draw("text", chart, { x: x(angles.length + 1), y: 56, "font-size": 15, fill: "var(--bad)" }, "✕");
    const after = angles.length, word = n => `${n} step${n === 1 ? "" : "s"}`;
    // The first step from which on every one is within a hundredth of the gait's.
    let back = after;
    while (aim && back > 0 && abs(angles[back - 1] / aim - 1) < 0.01) back--;
    const cause = FALLS[last.fall] ?? "", fell = cause.startsWith("the") ? cause : `it ${cause}`;
    text.textContent = last.fall ? `${after ? `After ${word(after)}` : "In its first step"} ${fell}.`
      : !aim || after - back <= 4 ? `It still walks after ${word(after)}, but not in this gait.`
      // An unstable gait is left, however slowly.
      : gait.radius < 1 ? back === 0 ? "It stays within 1 % of the gait." : `It recovers: within 1 % of the gait after ${word(back)}.` : `After ${word(after)} it is still within 1 % of this ${gait.radius > 1 ? "unstable " : ""}gait.`;
  }

  select = (wish, options = {}) => {
    const own = wish.at && lineAt(wish.at, wish.slope), named = wish.start && !wish.free && !own && cellNamed(wish), line = own ?? (wish.at && !named && !wish.map && (lineOfGrid(wish.at) ?? lineOfCell(wish.at)));
    const [map, cell] = wish.map ? [wish.map, wish.cell] : named || [];
    const found = map ? gaitOfCell(map, cell) : wish.free ? (wish.given || line) && freeMotion(wish.given ?? line, wish) : line ? gaitNear(line, wish.slope, wish.start) : null;
    const still = map ? cellOf(map, cell).slope === 0 : wish.slope === 0 && !line?.over || wish.start?.[0] === 0;
    say(found?.nearby ? "Here the branch ends; this is the nearest of its gaits." : found ? "" : still ? "Here the steps have no length: nothing walks." : map ? "No gait is stored for this cell." : whyNot(wish));
    if (found) show(found, options); else if (options.dock) clear();
    if (options.dock) dock(true);
    if (found && options.dock) {
      document.dispatchEvent(new CustomEvent("docked", { detail: panel.getBoundingClientRect().top || innerHeight }));
      if (!STILL.matches) play(true);
    }
    return found;
  };

  find("units").onchange = () => { facts(); portrait(); frame(); };
  find("slide").oninput = event => slideTo(Number(event.target.value));
  find("scrub").oninput = event => {
    play(false);
    const now = motion.at(time);
    time += Number(event.target.value) * durationOf(now.step) - now.t;
    frame();
  };
  const skip = share => { play(false); time = max(motion.begins[0], time + share * durationOf(motion.at(time).step)); frame(); };
  const along = by => { if (!find("along").hidden) slideTo((wanted ?? gait.place) + by); };
  const clicks = { play: () => play(!playing), close: () => dock(false), push: () => push(1), pull: () => push(-1), reset: () => show(gait), step: () => skip(1 / 24) };
  for (const name in clicks) button(name).onclick = clicks[name];
  on(panel, "keydown", event => {
    if (isBrowsers(event)) return;
    const typed = event.target.matches("input, select"), act = { " ": () => play(!playing), ".": () => skip(1 / 24), ",": () => skip(-1 / 24), ArrowRight: () => along(1), ArrowLeft: () => along(-1),
      p: () => push(1), P: () => push(-1), r: () => show(gait) }[event.key];
    if (!act || (typed && !["p", "P", "r"].includes(event.key)) || (event.key === " " && event.target.matches("button"))) return;
    event.preventDefault();
    act();
  });

  on(window, "keydown", event => { if (event.key === "Escape") dock(false); });

  const followAddress = () => {
    const wish = location.hash.length > 1 && readAddress(location.hash);
    // What is left out of an address, or is rounded there, is solved; the address then has it.
    return wish && { wish, found: select(wish, { dock: panel.closest("section") !== null, write: true }) };
  };
  on(window, "hashchange", followAddress);
  // Once the figures and tables below have been made ready, they hear of the first gait.
  on(window, "DOMContentLoaded", () => {
    const given = followAddress();
    if (given?.found) return;
    const first = MAPS.some(map => !map.free) && lead || LINES.map(line => readAddress(line.first)).find(Boolean) || lead;
    if (first) { const words = find("said").textContent; if (select(first, { write: false })) { if (given) say(`${words} Shown is another gait of this page.`); return; } }
    if (!gait) panel.hidden = !docked;
  });
}
