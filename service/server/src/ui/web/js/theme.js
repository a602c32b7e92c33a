// Runs before the first paint, so that a page never flashes the other theme or the other language.
(() => {
  const asked = new URLSearchParams(location.search);
  const kept = (name) => { try { return localStorage.getItem(name); } catch { return null; } };
  const root = document.documentElement;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  root.dataset.theme = asked.get("theme") || kept("theme") || (dark.matches ? "dark" : "light");
  const language = asked.get("lang") || kept("lang") || navigator.language || "en";
  root.lang = language.toLowerCase().startsWith("de") ? "de" : "en";
  if (asked.get("view") === "wall") root.dataset.view = "wall";
})();
