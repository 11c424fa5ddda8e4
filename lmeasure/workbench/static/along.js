// A trajectory over time: plots with bands that hold 95 %, one cursor, a span that comes nearer; gaps that are jumped to.
import {number, own} from './number.js';
import {letters, root} from './root.js';
const place = document.getElementById('along'), id = (name) => document.getElementById(name);
const whole = [Number(place.dataset.begin), Number(place.dataset.end)];
const plots = [...place.querySelectorAll('canvas')], digits = {u95: 4, angle: 1};
let span = [...whole], at = whole[0], data = null, asked = 0;

const colour = (name) => getComputedStyle(document.body).getPropertyValue(name);
const left = () => 5.4 * parseFloat(letters(0.8125));
const across = (canvas, t) => left() + (canvas.clientWidth - left() - 10) * (t - span[0]) / (span[1] - span[0] || 1);
const timeAt = (canvas, x) => Math.min(span[1], Math.max(span[0], span[0] + (x - left()) / (canvas.clientWidth - left() - 10) * (span[1] - span[0])));

function nearest() {
  let best = 0;
  data.time_s.forEach((t, i) => { if (Math.abs(t - at) < Math.abs(data.time_s[best] - at)) best = i; });
  return best;
}

function paint(canvas) {
  const name = canvas.dataset.series, values = data[name], half = data[`u_${name}`], pen = canvas.getContext('2d'), ratio = devicePixelRatio || 1;
  canvas.width = canvas.clientWidth * ratio; canvas.height = canvas.clientHeight * ratio; pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  const high = canvas.clientHeight, known = values.map((v, i) => v !== null ? i : -1).filter((i) => i >= 0);
  const low = Math.min(...known.map((i) => values[i] - (half?.[i] ?? 0))), top = Math.max(...known.map((i) => values[i] + (half?.[i] ?? 0)));
  const room = (top - low) || Math.abs(top) || 1, y = (v) => 26 + (high - 48) * (1 - (v - low + 0.04 * room) / (1.08 * room));
  pen.clearRect(0, 0, canvas.clientWidth, high); pen.font = letters(0.8125); pen.fillStyle = colour('--ink');
  pen.fillText(canvas.getAttribute('aria-label'), 4, 14);
  if (!known.length) { pen.fillText('–', 80, high / 2); return; }
  const ten = 10 ** Math.floor(Math.log10(room / 4)), step = [1, 2, 5, 10].map((n) => n * ten).find((v) => v >= room / 4);
  const ticks = Math.max(0, Math.min(9, -Math.floor(Math.log10(step) + 1e-9)));
  pen.fillStyle = colour('--soft'); pen.strokeStyle = colour('--line'); pen.lineWidth = 1;
  for (let v = Math.ceil(low / step) * step, n = 0; v <= top && n < 12; v += step, n++) {
    pen.beginPath(); pen.moveTo(left(), y(v)); pen.lineTo(canvas.clientWidth - 10, y(v)); pen.stroke();
    pen.fillText(number(v, ticks), 4, y(v) + 4);
  }
  pen.fillText(`${number(span[0], 2)} ${place.dataset.s}`, left(), high - 6); const end = `${number(span[1], 2)} ${place.dataset.s}`; pen.fillText(end, canvas.clientWidth - 10 - pen.measureText(end).width, high - 6);
  if (half) {
    pen.fillStyle = colour('--act'); pen.globalAlpha = 0.3;
    let run = [];
    const fill = () => {
      if (run.length > 1) { pen.beginPath(); run.forEach((i) => pen.lineTo(across(canvas, data.time_s[i]), y(values[i] + half[i]))); run.reverse().forEach((i) => pen.lineTo(across(canvas, data.time_s[i]), y(values[i] - half[i]))); pen.fill(); }
      run = [];
    };
    values.forEach((v, i) => { if (v === null || half[i] === null) fill(); else run.push(i); }); fill(); pen.globalAlpha = 1;
  }
  pen.strokeStyle = colour('--act'); pen.lineWidth = 1.5; pen.beginPath(); let down = false;
  values.forEach((v, i) => { if (v === null) { down = false; return; } pen[down ? 'lineTo' : 'moveTo'](across(canvas, data.time_s[i]), y(v)); down = true; });
  pen.stroke(); pen.strokeStyle = colour('--bad'); pen.beginPath(); pen.moveTo(across(canvas, at), 20); pen.lineTo(across(canvas, at), high - 20); pen.stroke();
}

function draw() {
  if (!data?.time_s) return;
  const i = nearest();
  for (const name of ['x', 'y', 'z']) id(`at-${name}`).textContent = `${number(data[name][i], 3)} ± ${number(data[`u_${name}`][i], 4)}`;
  for (const name of ['u95', 'angle']) id(`at-${name}`).textContent = number(data[name][i], digits[name]);
  id('cursor').value = 1000 * (at - whole[0]) / (whole[1] - whole[0] || 1);
  id('cursor-reported').textContent = `${number(data.time_s[i], 3)} ${place.dataset.s}`; id('near-reported').textContent = `${own((span[1] - span[0]).toPrecision(3))} ${place.dataset.s}`;
  place.dataset.at = data.time_s[i]; plots.forEach(paint);
}

async function look() {
  const mine = ++asked, query = `begin=${span[0]}&end=${span[1]}`;
  const answer = await fetch(`${root}/along/${place.dataset.path.split('/').map(encodeURIComponent).join('/')}?${query}`);
  const reported = await answer.json();
  if (mine !== asked) return;
  if (reported.error) { id('cursor-reported').textContent = reported.error; return; }
  if (reported.time_s) data = reported;
  id('export').href = `${root}/export/${place.dataset.path}?${query}`; place.dataset.shown = query; draw();
}

let waiting;
function near(width, middle = at) {
  const all = whole[1] - whole[0], wide = Math.max(Math.min(width, all), all / 1e5);
  const begin = Math.min(Math.max(middle - wide / 2, whole[0]), whole[1] - wide);
  span = [begin, begin + wide]; clearTimeout(waiting); waiting = setTimeout(look, 60); draw();
}

id('cursor').addEventListener('input', () => { at = whole[0] + id('cursor').value / 1000 * (whole[1] - whole[0]); if (at < span[0] || at > span[1]) near(span[1] - span[0]); else draw(); });
id('near').addEventListener('input', () => near((whole[1] - whole[0]) * 10 ** (-id('near').value / 25)));
for (const canvas of plots) {
  const move = (event) => { if (event.buttons) { at = timeAt(canvas, event.offsetX); draw(); } };
  canvas.addEventListener('pointerdown', move); canvas.addEventListener('pointermove', move);
  canvas.addEventListener('wheel', (event) => { event.preventDefault(); near((span[1] - span[0]) * (event.deltaY > 0 ? 1.25 : 0.8), timeAt(canvas, event.offsetX)); }, {passive: false});
}
for (const button of document.querySelectorAll('.stretches button')) button.addEventListener('click', () => {
  const [a, b] = [Number(button.dataset.begin), Number(button.dataset.end)];
  at = a; near(Math.max(4 * (b - a), (whole[1] - whole[0]) / 50), (a + b) / 2); place.scrollIntoView({block: 'start'});
});
for (const details of document.querySelectorAll('details.viewer')) details.addEventListener('toggle', () => {
  if (!details.open || details.querySelector('iframe')) return;
  const frame = document.createElement('iframe'); frame.className = 'report'; frame.title = details.querySelector('summary').textContent; frame.src = details.dataset.src; details.append(frame);
});
new ResizeObserver(draw).observe(place); matchMedia('(prefers-color-scheme: dark)').addEventListener('change', draw); look();
