// Theme of every page: as the device has it, or as was chosen last on any of them.
"use strict";
(() => {
  const KEY = "kart-report-theme", list = document.getElementById("theme");
  function setTheme(theme) {
    if (theme === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = theme;
  }
  list.addEventListener("change", () => {
    setTheme(list.value);
    try { localStorage.setItem(KEY, list.value); } catch { /* a page from disk may not be allowed to */ }
  });
  let chosen = null;
  try { chosen = localStorage.getItem(KEY); } catch { /* likewise */ }
  if (["light", "dark"].includes(chosen)) { list.value = chosen; setTheme(chosen); }
})();
