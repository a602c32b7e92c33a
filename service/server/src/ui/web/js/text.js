// Texts by key, in German or English. A text with parts is a function of them.
import { en } from "./words/en.js";
import { de } from "./words/de.js";
import { inGerman } from "./words/said-de.js";

export const language = document.documentElement.lang === "de" ? "de" : "en";
const words = language === "de" ? de : en;
export const t = (key, parts) => {
  const text = words[key] ?? en[key];
  if (text === undefined) throw new Error(`no text ${key}`);
  return typeof text === "function" ? text(parts ?? {}) : text;
};
/** Characters that the server takes as a reason. */
export const MOST_REASON = 1000;
/** What was written in a box of several lines as the server takes a reason: in one, without control characters. */
export const oneLine = (text) => text.replace(/[\s\p{Cc}]+/gu, " ").trim();
/** The text of a code that the server gave; what it said itself where the code is new. */
export const told = (prefix, code, otherwise) => { const text = words[`${prefix}.${code}`]; return text === undefined ? otherwise ?? code : typeof text === "function" ? text({}) : text; };
/** What the server says at a field, in the page's language where it is known there. */
export const saidAt = (message) => language === "de" ? inGerman(message) : message;
export const setLanguage = (to) => { try { localStorage.setItem("lang", to); } catch { /* a private window */ } const here = new URL(location.href); here.searchParams.delete("lang"); location.replace(here); if (here.href === location.href) location.reload(); };
