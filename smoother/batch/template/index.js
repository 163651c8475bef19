// Sorting, searching and unit of the index. The tables stand in the page without it; text stays text.
"use strict";
(() => {
  const UNITS = { "km/h": 3.6, mph: 1 / 0.44704 };
  const place = (id) => document.getElementById(id);
  const body = document.querySelector("#all tbody");
  const rows = body ? [...body.rows] : [];

  function remember(key, value) {
    try { localStorage.setItem(key, value); } catch { /* a page from disk may not be allowed to */ }
  }
  function remembered(key) {
    try { return localStorage.getItem(key); } catch { return null; }
  }
  function setUnit(unit) {
    for (const cell of document.querySelectorAll("[data-mps]")) {
      cell.textContent = (Number(cell.dataset.mps) * UNITS[unit]).toFixed(1);
    }
    for (const name of document.querySelectorAll(".speed-unit")) name.textContent = unit;
  }

  const compare = new Intl.Collator(undefined, { numeric: true }).compare;
  function sortBy(column, descending) {
    const key = (row) => {
      const cell = row.cells[column];
      return "value" in cell.dataset ? Number(cell.dataset.value) : cell.textContent.trim();
    };
    const unknown = (value) => value === "–" || value === "" || Number.isNaN(value);
    const order = (a, b) => (typeof a === "number" && typeof b === "number" ? a - b : compare(String(a), String(b)));
    const keyed = rows.map((row) => [key(row), row]);
    keyed.sort(([a], [b]) => {
      if (unknown(a) || unknown(b)) return unknown(a) - unknown(b); // what is not known stays below
      return descending ? order(b, a) : order(a, b);
    });
    body.append(...keyed.map(([, row]) => row));
  }
  document.querySelectorAll("#all th").forEach((head, column) => {
    head.querySelector("button").addEventListener("click", () => {
      const descending = head.getAttribute("aria-sort") === "ascending";
      document.querySelectorAll("#all th").forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", descending ? "descending" : "ascending");
      sortBy(column, descending);
    });
  });

  function search() {
    const words = place("search").value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
      shown += row.hidden ? 0 : 1;
    }
    place("shown").textContent = `${shown} of ${rows.length}`;
  }
  if (place("search")) place("search").addEventListener("input", search);

  place("units").addEventListener("change", (e) => { setUnit(e.target.value); remember("kart-report-units", e.target.value); });
  const unit = remembered("kart-report-units");
  if (unit in UNITS) { place("units").value = unit; setUnit(unit); }
  if (place("search")) search();
})();
