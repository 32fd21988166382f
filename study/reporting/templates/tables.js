"use strict";
// Tables can be sorted by a column and, where they are long, searched; the second page can be
// searched as a whole. Without scripts all stays as it is written: nothing below is needed to read.
const LONG = 12;
const number = (text) => {
  const plain = text.replace(/\u2212/g, "-").replace(/,/g, "").replace(/^[<>\u00d7\s\u00a0]+/, "");
  const found = parseFloat(plain);
  return Number.isNaN(found) ? null : found;
};
const compare = (a, b) => {
  const [x, y] = [number(a), number(b)];
  if (x !== null && y !== null) return x - y;
  if (x !== null || y !== null) return x === null ? 1 : -1;
  return a.localeCompare(b);
};
const sortable = (table) => {
  const body = table.tBodies[0];
  const written = [...body.rows];
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const next = { none: "ascending", ascending: "descending", descending: "none" };
      const order = next[head.getAttribute("aria-sort") || "none"];
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      const rows = [...written];
      if (order !== "none") {
        head.setAttribute("aria-sort", order);
        const sign = order === "ascending" ? 1 : -1;
        const text = (row) => row.cells[column].textContent.trim();
        rows.sort((a, b) => sign * compare(text(a), text(b)));
      }
      body.append(...rows);
    });
  });
};
const searchable = (table) => {
  const rows = [...table.tBodies[0].rows];
  if (rows.length < LONG) return;
  const label = document.createElement("label");
  const input = document.createElement("input");
  label.className = "search";
  input.type = "search";
  label.append("Show rows that contain ", input);
  table.parentElement.before(label);
  input.addEventListener("input", () => {
    const wanted = input.value.toLowerCase();
    rows.forEach((row) => { row.hidden = !row.textContent.toLowerCase().includes(wanted); });
  });
};
document.querySelectorAll(".scroll table").forEach((table) => {
  if (table.tBodies.length !== 1 || table.tBodies[0].rows.length < 3) return;
  sortable(table);
  searchable(table);
});
const nav = document.querySelector("nav[aria-label=Contents]");
const sections = [...document.querySelectorAll("main > section")];
if (nav && sections.length > 1) {
  const label = document.createElement("label");
  const input = document.createElement("input");
  label.className = "search filter";
  input.type = "search";
  label.append("Search this page ", input);
  (getComputedStyle(nav).display === "none" ? document.querySelector("main header") : nav.firstElementChild).append(label);
  input.addEventListener("input", () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    const holds = (part) => words.every((word) => part.textContent.toLowerCase().includes(word));
    sections.forEach((section) => {
      // where the heading has the words the whole section is meant
      const whole = holds(section.querySelector("h2") || section);
      const parts = [...section.children].filter((part) => !/^H[1-6]$/.test(part.tagName));
      parts.forEach((part) => { part.hidden = !whole && !holds(part); });
      section.hidden = parts.every((part) => part.hidden);
    });
  });
}
