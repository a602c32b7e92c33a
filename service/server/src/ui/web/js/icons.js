import { trusted, escape } from "./html.js";

// Every state has its own outline; it reads without colour and at 16 px.
const S = (body, label) => `<svg class="icon" viewBox="0 0 16 16" fill="none" stroke="currentColor" stroke-width="1.6" ${label ? `role="img" aria-label="${escape(label)}"` : 'aria-hidden="true"'}>${body}</svg>`;
const shapes = {
  drilling: '<circle cx="8" cy="8" r="7" fill="currentColor" stroke="none"/><path d="M8 4v7M5 8.2 8 11.2l3-3" stroke="var(--surface)" stroke-width="1.6"/>',
  running: '<circle cx="8" cy="8" r="7" fill="currentColor" stroke="none"/><path d="M6.2 4.8v6.4L11.4 8z" fill="var(--surface)" stroke="none"/>',
  idle: '<circle cx="8" cy="8" r="6.2"/><path d="M6.3 5.6v4.8M9.7 5.6v4.8"/>',
  setup: '<circle cx="8" cy="8" r="6.2"/><path d="M8 1.8a6.2 6.2 0 0 1 0 12.4z" fill="currentColor" stroke="none"/>',
  silent: '<circle cx="8" cy="8" r="6.2" stroke-dasharray="2.4 2.4"/><path d="M3.6 12.4l8.8-8.8"/>',
  act: '<path d="M5 .8h6L15.2 5v6L11 15.2H5L.8 11V5z" fill="currentColor" stroke="none"/><path d="M8 4v5M8 10.6v1.6" stroke="var(--act-ink)" stroke-width="1.8"/>',
  plan: '<path d="M8 1 15.6 14.6H.4z" fill="currentColor" stroke="none"/><path d="M8 5.6v4.2M8 11.2v1.5" stroke="var(--plan-ink)" stroke-width="1.7"/>',
  note: '<circle cx="8" cy="8" r="6.2"/><path d="M8 7.2v4M8 4.4v1.4"/>',
  ok: '<circle cx="8" cy="8" r="6.2"/><path d="M5 8.2l2.1 2.2L11 6"/>',
  none: '<circle cx="8" cy="8" r="6.2" stroke-dasharray="1.5 2.4"/>',
  fleet: '<path d="M1.8 2.8h5v4h-5zM9.2 2.8h5v4h-5zM1.8 9.2h5v4h-5zM9.2 9.2h5v4h-5z"/>',
  cycle: '<path d="M1.5 13.5V2.5M1.5 13.5h13M3.5 11c1.5 0 1.8-6 3.4-6s1.6 4 3 4 1.3-2.4 3.6-2.4"/>',
  tool: '<path d="M5.2 1.5h5.6v4L9.6 8v3L8 14.6 6.4 11V8L5.2 5.5z"/>',
  profile: '<path d="M1.5 12l3.4-2 3-5.4 3 3.4 3.6-3.6"/><circle cx="4.9" cy="10" r="1.5" fill="currentColor" stroke="none"/><circle cx="7.9" cy="4.6" r="1.5" fill="currentColor" stroke="none"/><circle cx="10.9" cy="8" r="1.5" fill="currentColor" stroke="none"/>',
  advice: '<path d="M2 2.5h12v8.2H8.4L5 13.8v-3.1H2z"/><path d="M5 6.6l2 2 4-4"/>',
  studies: '<path d="M8 1.5l5.6 4.1-2.1 6.6H4.5L2.4 5.6z"/><path d="M8 4.6l2.8 2-1 3.4H6.2l-1.2-3.4z"/>',
  more: '<path d="M3 8h.01M8 8h.01M13 8h.01" stroke-width="2.6" stroke-linecap="round"/>',
  sun: '<circle cx="8" cy="8" r="3"/><path d="M8 .8v2M8 13.2v2M.8 8h2M13.2 8h2M2.9 2.9l1.4 1.4M11.7 11.7l1.4 1.4M2.9 13.1l1.4-1.4M11.7 4.3l1.4-1.4"/>',
  undo: '<path d="M3 6.5h7a3.5 3.5 0 0 1 0 7H6M3 6.5l3-3M3 6.5l3 3"/>',
  lock: '<path d="M3.5 7.5h9v6h-9zM5.5 7.5V5a2.5 2.5 0 0 1 5 0v2.5"/>',
  download: '<path d="M8 1.5v9M4.5 7.2 8 10.7l3.5-3.5M2 14h12"/>',
  out: '<path d="M6.5 2H2.5v12h4M7 8h7M11 5l3 3-3 3"/>',
};
export const icon = (name, label) => trusted(S(shapes[name] ?? shapes.none, label));
