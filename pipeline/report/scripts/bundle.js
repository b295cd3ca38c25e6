// All pages of a report in one file: the page that the address names takes this one's place.
const { texts, style, script } = JSON.parse(document.getElementById("bundle").textContent), { hash, search } = location;
const text = texts[decodeURIComponent(search.slice(1))] ?? texts.index;
document.open();
document.write(text.replace("<style></style>", () => `<style>${style}</style>`).replace("<script><\/script>", () => `<script>${script}<\/script>`));
document.close();
// The page is another now: its place named in the address is found anew.
if (hash) location.replace(hash);
