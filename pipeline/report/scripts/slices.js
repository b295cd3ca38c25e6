// Slices of a grid of three axes or more: a choice of quantity, gait and two axes, and a slider through each of the others.

const CIVIDIS = ["#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55", "#fee838"];

for (const box of nodesOf(".slices")) {
  const find = name => box.querySelector(name), grid = JSON.parse(find("script").textContent), { axes, lines, gaits, quantities, fields } = grid;
  const svg = find("svg"), sizes = axes.map(axis => axis.values.length), points = sizes.reduce((a, b) => a * b), titles = axes.map(axis => axis.title);
  GRIDS.push(grid);
  box.closest("section").hidden = false;
  function control(words, node) {
    const label = find(".controls").appendChild(make("label", "", words));
    label.append(node);
    node.oninput = show;
    return node;
  }
  function choice(words, names, chosen = 0) {
    const list = control(words + " ", make("select"));
    list.append(...names.map((name, i) => new Option(name, i)));
    list.value = chosen;
    list.parentNode.hidden = names.length < 2;
    return list;
  }
  const walker = choice("Walker", lines.map(line => line.at.walker)), gait = choice("Gait", gaits), what = choice("Quantity", quantities.map(one => one[1]));
  const sides = [choice("Across", titles, sizes.length - 1), choice("Up", titles, sizes.length - 2)];
  const sliders = sizes.map(n => control(" ", Object.assign(make("input"), { type: "range", max: n - 1, value: n >> 1 })));
  const chosen = () => sides.map(side => axes[side.value]);

  /** All values of a field for the walker and the gait chosen, NaN where there is none. */
  function valuesOf(name) {
    const field = fields[name], mask = field.present ?? fields.present, whole = mask.read ??= readField(mask, [lines.length * gaits.length, points]);
    field.read ??= field.texts.flatMap(text => [...readField({ ...field, text }, sizes.slice(-2))]).map((value, i) => whole[i] ? value : NaN);
    const first = (walker.value * gaits.length + Number(gait.value)) * points;
    return field.read.slice(first, first + points);
  }
  const placesOf = cell => sliders.map((slider, k) => cell[sides.findIndex(side => side.value == k)] ?? Number(slider.value));
  const indexOf = cell => placesOf(cell).reduce((at, place, k) => at * sizes[k] + place, 0);
  let at, cells, values;

  function point(cell) {
    if (!cells[cell]) return;
    cells[at]?.removeAttribute("stroke");
    at = cell;
    set(cells[at], { stroke: "var(--bad)" });
    svg.append(cells[at]);
    const value = values[indexOf(cell)], places = placesOf(cell);
    const pairs = axes.map((axis, k) => [axis.title, axis.values[places[k]]]);
    if (value === value) pairs.push([quantities[what.value][1], value]);
    find("output").textContent = pairs.map(([title, x]) => title + " = " + brief(x)).join(", ") + (value === value ? "" : ": no gait");
  }
  function walk() {
    const places = placesOf(at), { slope, ...place } = { ...lines[walker.value].at, ...Object.fromEntries(axes.map(({ name, values }, k) => [name, values[places[k]]])) };
    const [angle, ...rates] = ["stance_angle", ...RATES].map(name => fields[name] && valuesOf(name)[indexOf(at)]);
    if (angle > 0) select({ at: place, slope, start: [angle, ...rates.filter(isFinite).map(rate => rate * angle)] }, { dock: true });
  }
  function show() {
    // Of two equal axes the one chosen last stays.
    if (sides[0].value === sides[1].value) sides[this === sides[0] ? 1 : 0].value = sides[0].value > 0 ? 0 : 1;
    const own = chosen();
    sliders.forEach((slider, k) => {
      slider.parentNode.hidden = own.includes(axes[k]);
      slider.previousSibling.textContent = `${titles[k]} = ${brief(axes[k].values[slider.value])} `;
    });
    // One scale of colours for all slices of a quantity and a gait.
    values = valuesOf(quantities[what.value][0]);
    const [low, high] = values.reduce(([a, b], v) => [v < a ? v : a, v > b ? v : b], [Infinity, -Infinity]);
    const scales = own.map(({ values: v }) => v[0] > 0 && v.at(-1) > 30 * v[0] ? v.map(log) : v);
    const edges = scales.map(v => [-1, ...v.keys()].map(i => ((v[i] ?? 2 * v[0] - v[1]) + (v[i + 1] ?? 2 * v[i] - v[i - 1])) / 2));
    const [x, y] = edges.map((e, k) => v => (k ? 246 : 66) + (k ? -232 : 324) * (v - e[0]) / (e.at(-1) - e[0]));
    svg.replaceChildren();
    cells = {};
    scales[0].forEach((_, i) => scales[1].forEach((_, j) => {
      const value = values[indexOf([i, j])], [left, top] = [x(edges[0][i]), y(edges[1][j + 1])];
      const fill = value === value ? CIVIDIS[min(9, floor(10 * (value - low) / (high - low || 1)))] : "var(--wash)";
      cells[[i, j]] = Object.assign(draw("rect", svg, { x: left, y: top, width: x(edges[0][i + 1]) - left, height: y(edges[1][j]) - top, fill, "stroke-width": 2 }), { place: [i, j] });
    }));
    own.forEach(({ values: v, title }, k) => {
      for (const i of new Set([0, 1, 2, 3, 4].map(n => n * (v.length - 1) >> 2))) {
        const [text, place] = [brief(v[i], 3), scales[k][i]];
        if (k) write(svg, 61, y(place) + 4, text, "end"); else write(svg, x(place), 261, text, "middle");
      }
      write(svg, k ? 14 : 228, k ? 130 : 284, title, "middle", -90 * k);
    });
    CIVIDIS.forEach((fill, k) => draw("rect", svg, { x: 406, y: 222.8 - 23.2 * k, width: 11, height: 23.2, fill }));
    if (high >= low) [low, (low + high) / 2, high].forEach((value, k) => write(svg, 421, 246 - 112 * k, brief(value, 3)));
    point(cells[at] ? at : scales.map(v => v.length >> 1));
  }
  for (const event of ["pointermove", "click"]) on(svg, event, ({ target }) => {
    if (!target.place) return;
    point(target.place);
    if (event === "click") walk();
  });
  svg.onkeydown = event => {
    const move = ARROWS[event.key];
    if (event.key === "Enter") walk();
    if (!move || isBrowsers(event)) return;
    event.preventDefault();
    point([at[0] + move[1], at[1] - move[0]]);
  };
  show();
}
