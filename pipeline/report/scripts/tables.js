// Tables: a click on a heading sorts the rows; a row that is a gait makes it walk. Ledger: a filter by words and verdict.

// Tables: a click on a heading sorts the rows.
for (const table of nodesOf("table.archive")) {
  const body = table.tBodies[0];
  if (!body || body.rows.length < 3) continue;
  const exact = cell => { const data = cell.querySelector("data"); return data ? Number(data.value) : NaN; };
  [...table.tHead.rows[0].cells].forEach((head, k) => {
    if (!head.textContent.trim()) return;
    const button = make("button", "sort");
    button.append(...head.childNodes);
    head.append(button);
    button.onclick = () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.ariaSort = down ? "descending" : "ascending";
      const rows = [...body.rows].map(row => [exact(row.cells[k]), row.cells[k].textContent, row]);
      rows.sort((a, b) => isNaN(a[0]) || isNaN(b[0]) ? a[1].localeCompare(b[1]) || 0 : a[0] - b[0]);
      if (down) rows.reverse();
      body.append(...rows.map(row => row[2]));
    };
  });
}

// All columns of a table and all digits of its numbers, on request.
for (const scroll of nodesOf(".scroll")) {
  const numbers = [...scroll.querySelectorAll("data")].filter(data => data.value.length > data.textContent.length), more = scroll.querySelectorAll("th.more").length;
  if (!more && !numbers.length) continue;
  const button = make("button", "save", `All ${more ? "columns and " : ""}digits`), texts = numbers.map(data => data.textContent);
  button.ariaPressed = false;
  button.onclick = () => {
    const whole = scroll.classList.toggle("whole");
    button.ariaPressed = whole;
    numbers.forEach((data, k) => { data.textContent = whole ? minusSign(data.value) : texts[k]; });
  };
  scroll.after(button);
}

// Rows of gaits that this page can start: a button in the first cell.
for (const row of nodesOf("tr[data-gait]")) {
  const wish = readAddress(row.dataset.gait), line = wish && lineAt(wish.at, wish.slope), place = line?.branches.length && placeOn(line, wish.slope, wish.start[0]);
  if (!(place ? place.apart < NEAR : line?.over && wish.start.length > 2)) continue;
  const button = make("button", "walk-it", "▸");
  button.title = "Show this gait walking";
  button.ariaLabel = `Show the gait at slope ${wish.slope} walking`;
  row.cells[0].prepend(button, " ");
  row.onclick = event => { if (event.target === button || !event.target.closest("a, button")) select(wish, { dock: true }); };
  on(document, "gait", ({ detail }) => row.classList.toggle("chosen",
    Boolean(detail) && !detail.free && sameLine(detail.at, wish.at) && hypot(rank(detail.slope) - rank(wish.slope), log(detail.start[0] / wish.start[0])) < 1e-3));
}

// Ledger: on a narrow screen claims are folded.
document.querySelector("main").classList.add("folding");
for (const claim of nodesOf(".claim")) {
  const button = make("button", "unfold", "▾");
  button.ariaLabel = `Show claim ${claim.id}`;
  button.ariaExpanded = false;
  button.onclick = () => button.ariaExpanded = claim.classList.toggle("open");
  claim.querySelector("h3").append(button);
}

// Commands: a button copies one.
for (const code of nodesOf("pre > code, .command > code, .how > code")) {
  const button = make("button", "copy", "Copy"), place = code.closest("pre") ?? code;
  button.onclick = () => {
    getSelection().selectAllChildren(code);
    button.textContent = document.execCommand("copy") ? "Copied" : "Selected";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  };
  if (place === code) code.after(button); else place.before(button);
}

/** Show those of some entries that hold all words of a form, and whatever else it asks for; `tell` is told how many. */
function filterBy(form, entries, isWanted, tell) {
  const apply = () => {
    const words = form.elements.words.value.toLowerCase().split(/\s+/).filter(Boolean);
    let count = 0;
    for (const entry of entries) {
      const text = entry.textContent.toLowerCase();
      entry.hidden = !(words.every(word => text.includes(word)) && isWanted(entry, words));
      count += !entry.hidden;
    }
    tell(count, words, form.querySelector("[role=status]"));
  };
  form.hidden = false;
  for (const event of ["input", "change"]) on(form, event, apply);
  on(form, "submit", event => event.preventDefault());
  // On the way back to a page the browser restores the words.
  on(window, "pageshow", apply);
  return apply;
}

// Ledger: filter by words and verdict.
for (const form of nodesOf(".filter:not(.search)")) {
  const claims = [...nodesOf(".claim")], { verdict } = form.elements;
  const apply = filterBy(form, claims, claim => !verdict.value || claim.dataset.verdict === verdict.value, (count, words, said) => {
    for (const family of nodesOf(".family")) family.hidden = !family.querySelector(".claim:not([hidden])");
    said.textContent = words.length || verdict.value ? `${count} of ${claims.length} claims` : "";
  });
  // A link leads to a claim whatever the filter.
  on(window, "hashchange", () => {
    const claim = claims.find(one => "#" + one.id === location.hash);
    if (claim?.hidden) { form.reset(); apply(); claim.scrollIntoView(); }
  });
}

// Index: a search over the titles, findings and claims of all pages.
for (const form of nodesOf(".search")) filterBy(form, nodesOf("#found li"), (_, words) => words.length, (count, words, said) => {
  document.getElementById("found").hidden = !count;
  said.textContent = words.length ? `${count} found` : "";
});

// On paper everything is unfolded but where the archive comes from.
on(window, "beforeprint", () => nodesOf("details:not(#provenance)").forEach(details => { details.open = true; }));
