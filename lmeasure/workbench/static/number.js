// Numbers as the language of the page writes them; a zero has no sign.
const russian = document.documentElement.lang === 'ru';
export const own = (text) => String(text).replace('.', russian ? ',' : '.').replace('-', '−');
export const number = (v, digits) => (v === null || v === undefined ? '–' : own((Math.abs(v) < 0.5 * 10 ** -digits ? 0 : v).toFixed(digits)));
export const numbers = (values, digits) => values.map((v) => number(v, digits)).join(russian ? '; ' : ', ');
