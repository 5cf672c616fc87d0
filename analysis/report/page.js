// Without this script all is there too; with it tables sort, runs filter, and links open what they point at.
const value = (cell) => {
  const text = cell.textContent.trim();
  const found = parseFloat(text);
  return text === "" ? null : Number.isNaN(found) ? text : found;
};
const compare = (a, b) =>
  typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });

for (const head of document.querySelectorAll("table.sortable th")) {
  const button = document.createElement("button");
  button.append(...head.childNodes);
  head.append(button);
  button.addEventListener("click", () => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    for (const other of head.parentNode.children) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const body = head.closest("table").tBodies[0];
    const rows = [...body.rows].map((row) => [value(row.cells[head.cellIndex]), row]);
    rows.sort(([a], [b]) => (a === null) - (b === null) || (a === null ? 0 : up ? compare(a, b) : compare(b, a)));
    body.append(...rows.map(([, row]) => row));
  });
}

const runs = [...document.querySelectorAll("details.run")];
const tools = document.getElementById("tools");
tools.hidden = false;
document.getElementById("filter").addEventListener("input", (event) => {
  const words = event.target.value.toLowerCase().split(/\s+/).filter(Boolean);
  for (const run of runs) {
    const text = run.querySelector("summary").textContent.toLowerCase();
    run.hidden = !words.every((word) => text.includes(word));
  }
  for (const scene of document.querySelectorAll(".scene")) scene.hidden = !scene.querySelector("details.run:not([hidden])");
});
document.getElementById("open").addEventListener("click", () => runs.forEach((run) => (run.open = !run.hidden)));
document.getElementById("close").addEventListener("click", () => runs.forEach((run) => (run.open = false)));

// A closed run's video is not looked at.
for (const run of runs)
  run.addEventListener("toggle", () => {
    const video = run.querySelector("video");
    if (video) run.open ? (video.preload = "metadata") : video.pause();
  });

const follow = () => {
  const target = document.getElementById(location.hash.slice(1));
  if (target?.matches("details")) target.open = true;
  target?.scrollIntoView();
};
addEventListener("hashchange", follow);
if (location.hash) follow();
