// Figures: values of the nearest point under the pointer, with the command that reproduces it; a click makes its gait
// walk. Zoom, legends, pictures to save. Text only, no markup.

const LEGENDS = {};

for (const plot of nodesOf(".plot")) {
  const parse = name => JSON.parse(plot.querySelector(`script.${name}`)?.textContent ?? "[]");
  const series = parse("marks"), panels = parse("panels"), frames = parse("axes"), svg = plot.querySelector("svg");
  const width = Number(plot.dataset.width), height = Number(plot.dataset.height), view = { x: 0, y: 0, w: width };
  const dot = plot.appendChild(make("span", "dot")), ring = plot.appendChild(make("span", "ring")), tip = plot.appendChild(make("div", "tip"));
  for (const map of panels) {
    for (const side of ["x", "y"]) map[side].values ??= panels[0][side].values;
    for (const name in map.same) map[name] = panels[map.same[name]][name];
    for (const name in map.fields) if (map.fields[name].as !== undefined) map.fields[name] = panels[map.fields[name].as].fields[name];
  }
  for (const curve of series) curve.starts &&= curve.starts.map(place => STATES[place]);
  MAPS.push(...panels);
  set(tip, { role: "status" });
  let at = null, pinned = false, chosen = null;

  // From the picture's coordinates to pixels of the plot and back.
  const scale = () => plot.clientWidth / view.w;
  const toPixels = ([x, y]) => [(x - view.x) * scale(), (y - view.y) * scale()];
  const isSeen = ([x, y]) => x >= view.x && x <= view.x + view.w && y >= view.y && y <= view.y + view.w * height / width;
  function pointer(event) {
    const box = plot.getBoundingClientRect();
    return [view.x + (event.clientX - box.left) / scale(), view.y + (event.clientY - box.top) / scale()];
  }
  function put(node, point) {
    const [x, y] = toPixels(point);
    node.hidden = !isSeen(point);
    node.style.left = `${x}px`;
    node.style.top = `${y}px`;
  }

  // Legend: pointing at a line makes it stand out, pressing hides it and shows it again.
  const buttons = [...plot.querySelectorAll(".legend button")], parts = [...plot.querySelectorAll("svg [data-line]")], away = new Set();
  function highlight(line) {
    if (!buttons.length) return;
    plot.classList.toggle("lit", line !== null && !away.has(line));
    for (const part of parts) part.classList.toggle("on", Number(part.dataset.line) === line);
  }
  for (const button of buttons) {
    const line = Number(button.dataset.line);
    button.onpointerenter = button.onfocus = () => highlight(line);
    button.onpointerleave = button.onblur = () => highlight(null);
    // A line that is hidden or shown is so in all figures of the page.
    const turn = isAway => {
      if (isAway) away.add(line); else away.delete(line);
      button.ariaPressed = !isAway;
      for (const part of parts) if (Number(part.dataset.line) === line) part.style.display = isAway ? "none" : "";
    };
    (LEGENDS[button.textContent] ??= []).push(turn);
    button.onclick = () => {
      const isAway = !away.has(line);
      for (const act of LEGENDS[button.textContent]) act(isAway);
      highlight(line);
    };
    // A second click within a moment shows this line alone, or all of them again.
    button.ondblclick = () => {
      const alone = buttons.every(other => other === button || away.has(Number(other.dataset.line)));
      for (const other of buttons) if (away.has(Number(other.dataset.line)) !== (other !== button && !alone)) other.click();
    };
  }

  function hide() { highlight(null); dot.hidden = tip.hidden = true; at = null; pinned = false; tip.classList.remove("pinned"); }
  hide();
  ring.hidden = true;
  /** The point of a curve or the cell of a map under the pointer: { curve, row } or { map, cell }, or null. */
  function under(event) {
    const place = pointer(event), [px, py] = toPixels(place);
    let best = null, least = 24;
    for (const curve of series) if (!away.has(curve.line)) curve.rows.forEach((row, r) => {
      const [x, y] = toPixels(row), distance = hypot(x - px, y - py) - (curve.above ? 4 : 0);
      if (distance < least && isSeen(row)) { least = distance; best = { curve, row: r }; }
    });
    return best ?? cellAt(place);
  }
  /** What a point or a cell says: where it lies, what it is, its values, its command. */
  function factsOf({ map, cell, curve, row }) {
    if (map) {
      const { at, shown, slope, known, command } = cellOf(map, cell), values = { ...at, slope };
      return { place: putOn(map, [map.x, map.y].map(side => values[side.name])), label: map.label, pairs: shown.map(([name, value]) => [name, typeof value === "number" ? brief(value, 7) : value]),
        command: known && !map.free && leads(keysOf(map, at), slope) ? withSlope(command, slope) : null };
    }
    const [x, y, more, ...values] = curve.rows[row], state = curve.free && curve.starts?.[row]?.slice(0, 3).join(" ");
    const command = typeof more === "string" ? more : more !== null && withSlope(curve.command, more);
    return { place: [x, y], label: curve.label, line: curve.line, pairs: curve.names.map((name, i) => [name, values[i]]), command: state ? `${command.replace("solve", "simulate")} --state ${state}` : command };
  }
  function show(item) {
    const { place, label, line, pairs, command } = factsOf(item), list = make("dl");
    at = item;
    highlight(line ?? null);
    for (const [name, value] of pairs) list.append(make("dt", "", name), make("dd", "", value));
    tip.replaceChildren(make("b", "", label), list);
    if (command) tip.append(make("code", "", command));
    put(dot, place);
    tip.hidden = false;
    const [px, py] = toPixels(place), wide = tip.offsetWidth, tall = tip.offsetHeight;
    tip.style.left = `${max(0, min(px + 14, plot.clientWidth - wide))}px`;
    tip.style.top = `${py > tall + 14 ? py - tall - 14 : py + 16}px`;
  }

  const isIn = (box, [x, y]) => x >= box[0] && x <= box[2] && y >= box[1] && y <= box[3];
  // What a point of a curve, or a cell of a map, makes walk: the very gait that the tip names.
  // Points that have commands of their own, which end in a slope, are each of another line.
  const isOfLine = (row, line) => `${row}`.includes(`,${line?.command} --slope`);
  const slopeOf = row => Number(`${row[2]}`.split(" ").pop());
  const lineOf = (curve, row) => LINES.find(line => line.command === curve.command || isOfLine(row, line));
  function wishOf({ map, cell, curve, row }) {
    if (map?.free) {
      const start = [map.x.values[cell[0]], map.y.values[cell[1]]];
      return map.at && { at: map.at, given: map, slope: map.slope, start: [...start, map.ratio === undefined ? NaN : start[1] * map.ratio], before: true, free: true };
    }
    if (map) return map.fields.stance_angle ? { map, cell } : null;
    const one = curve.rows[row], line = lineOf(curve, one), value = slopeOf(one), start = curve.starts?.[row], { slope, ...at } = line?.at ?? {};
    if (line?.along) at[line.along] = value;
    return line && start?.length && isFinite(value) ? { at, slope: slope ?? value, start, free: curve.free } : null;
  }
  function placeIn(side, share) {
    const apart = v => abs(shareOf(side, v) - share);
    return side.values.reduce((best, v, i) => apart(v) < apart(side.values[best]) ? i : best, 0);
  }
  function cellAt([x, y]) {
    const map = panels.findLast(({ box }) => isIn(box, [x, y]));
    if (!map) return null;
    const { box } = map;
    return { map, cell: [placeIn(map.x, (x - box[0]) / (box[2] - box[0])), placeIn(map.y, (box[3] - y) / (box[3] - box[1]))] };
  }
  const shareOf = (side, value) => side.log ? log(value / side.limits[0]) / log(side.limits[1] / side.limits[0]) : (value - side.limits[0]) / (side.limits[1] - side.limits[0]);

  const putOn = ({ box, x, y }, at) => [box[0] + shareOf(x, at[0]) * (box[2] - box[0]), box[3] - shareOf(y, at[1]) * (box[3] - box[1])];
  // The rates of a basin of kneed walkers are those before heelstrike.
  const rateBefore = ({ walker, start }) => walker.kneed ? sectionOf(walker, start)[1] : start[start.length / 2];
  /** Where a gait lies in this figure: between the two nearest points of its line, or in its cell of a map. */
  function locate(gait) {
    const named = gait.map ? [gait.map, gait.cell] : gait.free ? null : cellNamed({ at: gait.at, slope: gait.slope, start: [gait.start[0]] });
    if (named && panels.includes(named[0])) return factsOf({ map: named[0], cell: named[1] }).place;
    for (const found of panels.filter(map => map.free && gait.free && sameLine(map.at ?? {}, gait.at))) {
      const point = putOn(found, [gait.start[0], rateBefore(gait) / gait.walker.time]), { box } = found;
      if (isIn(box, point)) return point;
    }
    for (const { rows } of series) for (const row of rows) if (isOfLine(row, gait.line) && abs(slopeOf(row) - gait.slope) < 1e-9) return row;
    const angles = curve => curve.starts?.map(start => start[0]);
    const { over, along } = gait.line ?? {}, value = over ? gait.at[along] : gait.slope;
    const isOf = curve => angles(curve) && (curve.command === (over ?? gait.line?.command) || lineOf(curve) && sameLine(lineOf(curve).at, gait.at));
    // Where slope and angle are the figure's own axes, the place follows from their scales.
    for (const curve of series.filter(isOf)) for (const one of frames) {
      const off = ([x, y], r) => hypot(...minus(putOn(one, [curve.rows[r][2], angles(curve)[r]]), [x, y]));
      if (curve.rows.every((row, r) => off(row, r) < 0.3)) return putOn(one, [value, gait.start[0]]);
    }
    const place = (curve, r) => [rank(curve.rows[r][2]), log(angles(curve)[r])];
    const target = [rank(value), log(gait.start[0])];
    let best = null, least = 0.08;
    for (const curve of series) {
      if (!isOf(curve)) continue;
      curve.rows.forEach((row, r) => {
        const a = place(curve, r), b = !curve.free && r + 1 < curve.rows.length ? place(curve, r + 1) : a, d = minus(b, a), size = d[0] ** 2 + d[1] ** 2;
        const share = size && size < 1 ? min(1, max(0, ((target[0] - a[0]) * d[0] + (target[1] - a[1]) * d[1]) / size)) : 0;
        const apart = hypot(target[0] - a[0] - share * d[0], target[1] - a[1] - share * d[1]), next = curve.rows[r + (share > 0)];
        if (apart < least) { least = apart; best = [row[0] + share * (next[0] - row[0]), row[1] + share * (next[1] - row[1])]; }
      });
    }
    return best;
  }
  function mark() {
    const point = chosen && locate(chosen);
    if (point) put(ring, point); else ring.hidden = true;
  }
  on(document, "gait", ({ detail }) => { chosen = detail; mark(); });
  on(window, "resize", () => { mark(); label(); if (at && !tip.hidden) show(at); });
  // What was chosen stays in sight above the panel.
  on(document, "docked", ({ detail }) => {
    const hidden = plot.contains(document.activeElement) && !ring.hidden ? ring.getBoundingClientRect().bottom + 24 - detail : 0;
    if (hidden > 0) scrollBy({ top: hidden });
  });

  // Numbers along the edges of a zoomed picture, for those of its axes are out of sight.
  const numbers = plot.appendChild(make("div", "numbers-on-edges"));
  numbers.ariaHidden = "true";
  function label() {
    numbers.replaceChildren();
    if (view.w === width) return;
    const tall = view.w * height / width, middle = [view.x + view.w / 2, view.y + tall / 2];
    const one = frames.find(({ box }) => isIn(box, middle));
    if (!one) return;
    const { box } = one, seen = [[view.x, view.x + view.w], [view.y + tall, view.y]];
    ["x", "y"].forEach((side, k) => {
      const { limits, log } = one[side], from = k ? box[3] : box[0], to = k ? box[1] : box[2];
      const value = pixel => { const t = min(1, max(0, (pixel - from) / (to - from))); return log ? limits[0] * (limits[1] / limits[0]) ** t : limits[0] + t * (limits[1] - limits[0]); };
      const [low, high] = seen[k].map(value), step = niceStep((high - low) / 5), ticks = [];
      if (one[side].title) numbers.append(make("b", side, one[side].title));
      // As many digits as tell a number from the next.
      const digits = tick => min(15, ceil(Math.log10(abs(tick) / step)) + 1);
      if (log && high > 8 * low) for (let n = floor(Math.log10(low)); n <= Math.log10(high); n++) ticks.push(10 ** n, ...(high < 200 * low ? [2 * 10 ** n, 5 * 10 ** n] : []));
      else for (let n = ceil(low / step); n * step <= high; n++) ticks.push(n * step);
      for (const tick of ticks) {
        const at = toPixels(putOn(one, k ? [one.x.limits[0], tick] : [tick, one.y.limits[0]]))[k];
        if (at < 0 || at > (k ? tall * scale() - 16 : plot.clientWidth)) continue;
        numbers.appendChild(make("span", side, brief(tick, max(4, digits(tick))))).style[k ? "top" : "left"] = `${at}px`;
      }
    });
    numbers.style.height = `${tall * scale()}px`;
  }

  // Zoom and pan of the picture.
  function look(w, [x, y] = [view.x + view.w / 2, view.y + view.w * height / width / 2]) {
    const next = min(width, max(width / 16, w)), share = next / view.w;
    view.x = min(width - next, max(0, x - (x - view.x) * share));
    view.y = min(height - next * height / width, max(0, y - (y - view.y) * share));
    view.w = next;
    set(svg, { viewBox: `${view.x} ${view.y} ${next} ${next * height / width}` });
    plot.classList.toggle("zoomed", next < width);
    label();
    if (at && !tip.hidden) show(at);
    mark();
  }
  if (series.length || panels.length) {
    const tools = plot.appendChild(make("div", "tools"));
    for (const [sign, words, act] of [["+", "Zoom in", () => look(view.w / 1.6)], ["−", "Zoom out", () => look(view.w * 1.6)], ["⤢", "Whole figure", () => look(width)]]) {
      const button = tools.appendChild(make("button", "", sign));
      button.title = words;
      button.ariaLabel = words;
      button.onclick = act;
    }
  }
  on(svg, "wheel", event => {
    if (!event.ctrlKey && view.w === width) return;
    event.preventDefault();
    look(view.w * Math.exp(event.deltaY * (event.ctrlKey ? 0.01 : 0.002)), pointer(event));
  }, { passive: false });
  const fingers = new Map(), box = plot.appendChild(make("span", "box"));
  let moved = false, wanted = null, tap = null;
  box.hidden = true;
  svg.onpointerdown = event => { fingers.set(event.pointerId, tap = event); moved = false; };
  on(window, "pointermove", event => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.clientX - last.clientX, event.clientY - last.clientY], rest = [...fingers.values()].filter(one => one.pointerId !== event.pointerId);
    if (!moved && hypot(dx, dy) < 5) return;
    if (rest.length === 1) {
      const gap = one => hypot(one.clientX - rest[0].clientX, one.clientY - rest[0].clientY);
      look(view.w * gap(last) / gap(event), pointer({ clientX: (event.clientX + rest[0].clientX) / 2, clientY: (event.clientY + rest[0].clientY) / 2 }));
    } else if (view.w < width) {
      view.x -= dx / scale();
      view.y -= dy / scale();
      look(view.w);
    } else if (event.pointerType === "mouse") {
      // A box drawn over the whole picture is what is seen next.
      const [a, b] = [last, event].map(pointer), w = max(abs(a[0] - b[0]), abs(a[1] - b[1]) * width / height);
      wanted = { x: (a[0] + b[0] - w) / 2, y: (a[1] + b[1] - w * height / width) / 2, w };
      put(box, [min(a[0], b[0]), min(a[1], b[1])]);
      box.style.width = `${abs(a[0] - b[0]) * scale()}px`;
      box.style.height = `${abs(a[1] - b[1]) * scale()}px`;
      moved = true;
      return;
    } else return;
    moved = true;
    fingers.set(event.pointerId, event);
  });
  for (const end of ["pointerup", "pointercancel"]) on(window, end, event => {
    fingers.delete(event.pointerId);
    if (wanted?.w > 4) { Object.assign(view, wanted); look(wanted.w); }
    wanted = null;
    box.hidden = true;
  });
  svg.ondblclick = () => look(width);

  plot.onpointermove = event => {
    if (pinned || fingers.size || event.target.closest(".tools, .legend")) return;
    const item = under(event);
    if (item) show(item); else if (event.pointerType === "mouse") hide();
    plot.style.cursor = item && wishOf(item) ? "pointer" : "";
  };
  plot.onpointerleave = () => { if (!pinned) hide(); };
  plot.onclick = event => {
    if (moved || tip.contains(event.target) || event.target.closest(".legend, .tools")) return;
    // A click is rounded to whole pixels, where dense screens have more: its press is not.
    const item = under(tap ?? event), wish = item && wishOf(item);
    tap = null;
    if (item) { show(item); pinned = true; tip.classList.add("pinned"); } else hide();
    if (wish) { select(wish, { dock: true }); if (matchMedia("(max-width: 40rem)").matches) hide(); }
  };
  plot.onblur = hide;
  plot.onkeydown = event => {
    const move = ARROWS[event.key];
    if (event.target !== plot || isBrowsers(event)) return;
    if (event.key === "Escape") return hide();
    if (event.key === "+" || event.key === "-") return look(view.w * (event.key === "+" ? 0.625 : 1.6), at ? factsOf(at).place : undefined);
    if (event.key === "0") return look(width);
    if (event.key === "Enter" && at) { const wish = wishOf(at); if (wish) select(wish, { dock: true }); return; }
    if (!move || !(series.length || panels.length)) return;
    event.preventDefault();
    if (at?.map) {
      // From cell to cell, and from a map's edge to the next map.
      const sides = [at.map.x, at.map.y], cell = [at.cell[0] + move[1], at.cell[1] - move[0]], over = [0, 1].find(k => cell[k] < 0 || cell[k] >= sides[k].values.length);
      if (over === undefined) return show({ map: at.map, cell });
      const next = panels[panels.indexOf(at.map) + (move[over ? 0 : 1] > 0 ? 1 : -1)];
      return next && show({ map: next, cell: [0, 0] });
    }
    if (!at) return show(series.length ? { curve: series[0], row: 0 } : { map: panels[0], cell: [0, 0] });
    const curve = series[(series.indexOf(at.curve) + move[0] + series.length) % series.length];
    show({ curve, row: max(0, min(curve.rows.length - 1, at.row + move[1])) });
  };

  for (const map of panels.slice(-1)) lead ??= map.first ? wishOf({ map, cell: map.first }) : wishOf(cellAt([(map.box[0] + map.box[2]) / 2, (map.box[1] + map.box[3]) / 2]));
  for (const curve of series) lead ??= wishOf({ curve, row: 0 });

  // The picture as a file, in the colours of the page as it is seen.
  function picture() {
    const copy = svg.cloneNode(true), style = getComputedStyle(document.documentElement), ground = style.getPropertyValue("--paper");
    set(copy, { width: 2 * width, height: 2 * height, "font-family": "sans-serif" });
    copy.prepend(draw("rect", copy, { x: -9, y: -9, width: width + 18, height: height + 18, fill: ground }));
    return new XMLSerializer().serializeToString(copy).replace(/var\((--[\w-]+)\)/g, (_, name) => style.getPropertyValue(name).trim());
  }
  function save(address, ending) {
    const link = make("a");
    link.href = address;
    link.download = `${location.pathname.split("/").pop().replace(/\.html$/, "")}-${plot.closest("section")?.id ?? "figure"}.${ending}`;
    link.click();
  }
  const asData = text => `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
  const file = plot.closest("figure")?.querySelector(".file");
  for (const [name, act] of file ? [["SVG", () => save(asData(picture()), "svg")], ["PNG", () => {
    const image = new Image();
    image.onload = () => {
      const canvas = make("canvas");
      [canvas.width, canvas.height] = [4 * width, 4 * height];
      canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
      save(canvas.toDataURL("image/png"), "png");
    };
    image.src = asData(picture());
  }]] : []) {
    const button = make("button", "save", name);
    button.onclick = act;
    file.append(" ", button);
  }
}
