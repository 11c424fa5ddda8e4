// The path before all pages of this session.
export const root = new URL('..', import.meta.url).pathname.slice(0, -1);
// Letters of a canvas, in parts of those of the page.
export const letters = (part) => `${part * parseFloat(getComputedStyle(document.documentElement).fontSize)}px system-ui`;
