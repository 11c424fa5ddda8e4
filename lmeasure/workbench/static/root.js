// The path before all pages of this session.
export const root = new URL('..', import.meta.url).pathname.slice(0, -1);
