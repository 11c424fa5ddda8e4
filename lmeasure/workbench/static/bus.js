// What comes over a bus: who speaks, what moves, a recording, a capture; and the simulated cell that is reported what to do.
import {number, numbers, own} from './number.js';
import {root} from './root.js';
const at = (id) => document.getElementById(id);
const {mm, mms, s: seconds} = document.body.dataset;
const make = (name, text = '', kind = '') => { const e = document.createElement(name); e.textContent = text; if (kind) e.className = kind; return e; };
const post = (address, form) => fetch(address, {method: 'POST', body: new URLSearchParams(form)});
const pause = (ms) => new Promise((done) => setTimeout(done, ms));
// what a list shows is changed, not made anew: a click on it is not lost
const rows = (list, count, row) => {
  while (list.children.length > count) list.lastChild.remove();
  while (list.children.length < count) list.append(row());
  return [...list.children];
};

// a server that has ended says nothing any more: the page does
export const gone = (is) => { at('gone').hidden = !is; };
// of a command line, every second one an option, which no line breaks
export const parts = (line) => line.split(/(--[a-z][\w-]*)/).map((text, i) => make('span', text, i % 2 ? 'kept' : ''));

// ---- the simulated cell ----
const cell = at('cell');
let act = '', goal = '', pressed = 0;
if (cell) {
  const type = (line) => post(`${root}/jobs/${cell.dataset.number}/type`, {line});
  cell.addEventListener('click', (event) => {
    const button = event.target.closest('button');
    if (!button) return;
    if (button.id === 'cell-asked') type(act || `go ${goal}`);
    else if (button.dataset.cable) { type(`${button.classList.contains('out') ? 'let' : 'pull'} ${button.dataset.cable}`); button.classList.toggle('out'); pressed = Date.now(); name(button); }
    else if (button.dataset.do) type(button.dataset.do);
  });
  const name = (button) => { button.textContent = `${button.dataset.cable}: ${button.classList.contains('out') ? cell.dataset.let : cell.dataset.pull}`; };
  const show = (reported) => {
    at('cell-at').textContent = `${reported.moves ? cell.dataset.goes : cell.dataset.stands} ${reported.at === 'home' ? cell.dataset.home : reported.at}: ${numbers(reported.pose, 2)}`;
    rows(at('cell-cables'), reported.cables.length, () => { const b = make('button'); b.type = 'button'; return b; })
      .forEach((b, i) => {
        b.dataset.cable = reported.cables[i];
        // what was asked just now stands, whatever was reported before
        if (Date.now() - pressed > 1500) b.classList.toggle('out', reported.out.includes(reported.cables[i]));
        name(b);
      });
    rows(at('cell-poses'), reported.poses.length, () => { const b = make('button'); b.type = 'button'; return b; })
      .forEach((b, i) => { b.dataset.do = `go ${reported.poses[i]}`; b.textContent = `${cell.dataset.go} ${reported.poses[i]}`; });
  };
  (async () => {
    while (true) {
      const reported = await fetch(`${root}/jobs/${cell.dataset.number}/last`).then((a) => (a.ok ? a.json() : null)).catch(() => null);
      gone(reported === null);
      if (reported?.last.cell && !document.hidden) show(reported.last.cell);
      if (reported && reported.state !== 'running') { cell.remove(); return; }
      await pause(document.hidden ? 2000 : 400);
    }
  })();
}
function wanted() {
  const button = at('cell-asked');
  if (!button) return;
  button.hidden = !(act || goal);
  button.textContent = act ? `${cell.dataset.asked}: ${act.replace(/^\w+/, (word) => cell.dataset[word] ?? word)}` : `${cell.dataset.go} ${goal}`;
}

// ---- adapters and who speaks ----
const scan = at('scan');
if (scan) {
  const field = (name) => document.querySelector(`form[data-command=check] [name=${name}]`);
  let running = 0;
  const begin = async (settings) => {
    at('scan-error').hidden = true;
    const head = {'Content-Type': 'application/json'};
    const answer = await fetch(`${root}/api/jobs`, {method: 'POST', headers: head, body: JSON.stringify({command: 'scan', settings})});
    const job = await answer.json();
    if (!answer.ok) { at('scan-error').hidden = false; at('scan-error').textContent = job.error; return null; }
    scan.querySelector('.line code').replaceChildren(...parts(job.line));
    running = job.number; at('scan-end').hidden = false;
    while (true) {
      const reported = await fetch(`${root}/jobs/${job.number}/last`).then((a) => a.json());
      if (reported.last.progress) at('scan-doing').textContent = reported.last.progress.text;
      if (reported.last.scan) spoken(reported.last.scan);
      if (reported.state !== 'running') {
        running = 0; at('scan-end').hidden = true; at('scan-doing').textContent = '';
        if (reported.result?.error && reported.result.exit_code !== 130) { at('scan-error').hidden = false; at('scan-error').textContent = reported.result.error; }
        return reported.result;
      }
      await pause(150);
    }
  };
  const spoken = (reported) => {
    at('scan-lines').hidden = false;
    rows(at('scan-lines').tBodies[0], reported.lines.length, () => { const r = make('tr'); for (let i = 0; i < 4; i++) r.append(make('td')); r.lastChild.append(make('code')); return r; })
      .forEach((r, i) => {
        const line = reported.lines[i], bytes = line.data ? line.data.split(' ') : [];
        [line.name, String(line.frames), number(line.rate_hz, 1)].forEach((text, j) => { r.cells[j].textContent = text; });
        rows(r.cells[3].firstChild, bytes.length, () => make('span')).forEach((s, j) => { s.textContent = `${bytes[j]} `; s.className = line.lit[j] ? 'lit' : ''; });
        r.className = line.lit.some(Boolean) ? 'lit' : '';
      });
  };
  const use = (bus, options) => { for (const [name, text] of [['bus', bus], ['bus_option', options.join('\n')]]) { const f = field(name); if (f) { f.value = text; f.dispatchEvent(new Event('input', {bubbles: true})); } } };
  at('scan-adapters').addEventListener('click', async () => {
    const result = await begin({});
    const found = result?.made ?? [], list = at('scan-found');
    list.replaceChildren(...(found.length ? found : [null]).map((one) => {
      if (one === null) return make('li', result?.error ? '' : scan.dataset.none);
      const item = make('li'), button = make('button', scan.dataset.use);
      button.type = 'button'; button.addEventListener('click', () => use(one.bus, one.options));
      item.append(make('code', [one.bus, ...one.options].join(' ')), make('span', one.about), button);
      return item;
    }));
  });
  at('scan-listen').addEventListener('click', () => begin({bus: field('bus').value, bus_option: field('bus_option').value.split('\n').filter(Boolean), seconds: 30}));
  at('scan-end').addEventListener('click', () => { if (running) post(`${root}/jobs/${running}/cancel`, {}); });
}

// ---- a self-test: the line that moves lights up ----
const reported = {
  asked: (e) => { act = e.act ?? ''; wanted(); },
  typed: () => { act = ''; wanted(); },
  moved: (e) => {
    const list = at('lines');
    if (!list || !e.channels.length) return;
    list.hidden = false;
    rows(list, e.channels.length, () => { const li = make('li'); li.append(make('span'), make('strong'), make('small')); return li; })
      .forEach((li, i) => {
        const c = e.channels[i], wrong = c.moves && !c.wanted && e.channels.some((o) => o.wanted);
        li.className = wrong ? 'unwanted' : c.moves ? 'moves' : 'still';
        li.children[0].textContent = c.channel; li.children[1].textContent = `${c.by > 0 ? '+' : ''}${number(c.by, 1)}${c.unit === 'mm' ? `\u00a0${mm}` : '°'}`;
        li.children[2].textContent = wrong ? list.dataset.unwanted : '';
      });
  },
  live: live,
  said: answered,
  capture: capture,
};
document.addEventListener('reported', (event) => reported[event.detail.event]?.(event.detail));

// ---- a recording ----
const ages = [];
let before = null, newest = null;
function live(e) {
  const box = at('live');
  if (!box) return;
  box.hidden = false;
  const pose = at('pose'), ok = e.pose.status === 'ok';
  if (ok) {
    if (pose.children.length === 1) pose.replaceChildren();
    const lines = rows(pose, 4, () => { const d = make('div'); d.append(make('span'), make('output')); return d; });
    ['x', 'y', 'z'].forEach((axis, i) => { lines[i].className = ''; lines[i].children[0].textContent = axis; lines[i].children[1].textContent = number(e.pose.position_mm[i], 2); });
    if (lines[3].className !== 'angles') { lines[3].className = 'angles'; lines[3].replaceChildren(); }
    rows(lines[3], e.pose.angles.length, () => make('span')).forEach((s, i) => { s.textContent = `${e.pose.angles[i][0]} ${number(e.pose.angles[i][1], 3)}°`; });
  } else {
    const lines = rows(pose, 1, () => make('div'));
    lines[0].replaceChildren(e.pose.shown || '–'); lines[0].className = 'words';
  }
  at('pose-u95').textContent = ok && e.pose.u95_mm !== null ? `± ${number(e.pose.u95_mm, 3)} ${mm} (95 %)` : '';
  at('pose-note').textContent = e.pose.text;
  rows(at('channels'), e.channels.length, () => { const li = make('li'); li.append(make('span'), make('strong'), make('small')); return li; })
    .forEach((li, i) => {
      const c = e.channels[i], kind = c.count === null ? 'silent' : Math.abs(c.mm_s ?? 0) > 0.5 ? 'moves' : 'still';
      li.className = kind;
      li.children[0].textContent = `${c.name} · ${box.dataset[kind]}`; li.children[1].textContent = number(c.count, 0); li.children[2].textContent = `${number(c.mm_s, 1)}\u00a0${mms}`;
    });
  at('live-seconds').textContent = number(e.seconds, 1);
  at('live-samples').textContent = e.samples;
  if (before === null || e.seconds < before[0]) before = [e.seconds, e.samples, null];
  if (e.seconds - before[0] >= 1) before = [e.seconds, e.samples, (e.samples - before[1]) / (e.seconds - before[0])];
  at('live-rate').textContent = number(before[2], 0);
  at('live-lost').textContent = e.lost;
  at('live-faults').textContent = e.faults_shown || '0';
  at('live-disk').textContent = e.disk_free === null ? '–' : number(e.disk_free / 1e9, 1);
  if (e.newest_s !== null && e.newest_s !== newest) {
    // from a frame's own time, by this machine's clock, until it stands in the page: one between two that are shown waits for the later
    ages.push(Date.now() - 1e3 * e.newest_s + 500 * (newest !== null && e.newest_s > newest ? e.newest_s - newest : 0));
    newest = e.newest_s;
    if (ages.length > 200) ages.shift();
    const sorted = [...ages].sort((a, b) => a - b), median = sorted[sorted.length >> 1];
    at('live-screen').textContent = median >= 0 && median < 60000 ? number(median, 0) : '–';
  }
}

// ---- a capture ----
const LINES = ['worst', 'rms', 'position'];
// why nothing was read, what was taken back: where one looks who has pressed, until the next reading; poses and readings stand there already
function answered(e) {
  const box = at('capture-said');
  if (!box || /^\s|^\S+ \S+ \(\d+ \S+ \d+\)/.test(e.text)) return;
  box.hidden = false; box.textContent = e.text.replace(/(\d) (?=(?:mm|мм)(?![\wа-я]))/g, '$1\u00a0');
}
function capture(e) {
  const box = at('capture');
  if (!box) return;
  box.hidden = false;
  goal = e.pose ?? ''; wanted();
  at('capture-pose').textContent = e.pose === null ? '' : `${e.pose}${e.back ? `: ${box.dataset.back}` : ''}`;
  rows(at('capture-typed'), e.typed.length, () => { const d = make('div'); d.append(make('dt'), make('dd')); return d; })
    .forEach((d, i) => { d.children[0].textContent = e.typed[i][0]; d.children[1].textContent = String(e.typed[i][1]); });
  at('capture-lamp').className = `lamp ${e.state}`;
  const silent = e.channels.filter((c) => c.silent).map((c) => c.name).join(', ');
  at('capture-state').textContent = e.state === 'still' ? `${box.dataset.still} ${number(e.still_s, 1)} ${seconds}` : [box.dataset[e.state], ...(silent ? [silent] : [])].join(': ');
  at('capture-still').value = e.state === 'still' ? Math.min(e.still_s / e.needs_s, 1) : 0;
  at('capture-doubt').hidden = !e.doubted; at('capture-doubt').textContent = e.doubted;
  rows(at('capture-poses'), e.poses.length, () => { const li = make('li'), b = make('button'); b.type = 'button'; li.append(b); return li; })
    .forEach((li, i) => {
      const one = e.poses[i];
      li.className = `${one.is === 'read' ? 'read' : one.is === 'open' ? 'open' : 'out'} ${one.name === e.pose ? 'wanted' : ''}`;
      li.firstChild.textContent = one.name; li.firstChild.dataset.type = `go ${one.name}`;
    });
  rows(at('capture-readings').tBodies[0], e.readings.length, () => { const r = make('tr'); for (let i = 0; i < 4; i++) r.append(make('td')); return r; })
    .forEach((r, i) => { const one = e.readings[i]; [one.pose, one.samples, own(one.spread), own(one.u_counts)].forEach((v, j) => { r.cells[j].textContent = v; }); });
  const narrow = box.querySelector('figure').clientWidth < 480, promised = e.promised?.enough ? e.promised : null, key = JSON.stringify([e.worth, promised, narrow]);
  if (key !== box.dataset.drawn) { box.dataset.drawn = key; plot(box, e.worth.filter((w) => w.enough), promised, narrow); }
  if (e.readings.length > (box.dataset.read ?? 0) || (e.doubted && at('capture-said').textContent.includes(e.doubted))) at('capture-said').hidden = true;
  box.dataset.read = e.readings.length;
  const last = e.worth.at(-1);
  at('capture-worth').textContent = e.promised && !promised ? `${box.dataset.poses}: ${e.promised.readings}; ${box.dataset.few}` : last === undefined ? '' : last.enough
    ? `${box.dataset.readings}: ${last.readings}; ${LINES.map((k) => [k, last[`${k}_mm`]]).filter(([, v]) => v !== null).map(([k, v]) => `${box.dataset[k]} ${own(+v.toPrecision(2))} ${mm}`).join(', ')}`
    : `${box.dataset.readings}: ${last.readings}; ${box.dataset.few}`;
}

// on a telephone names stand in a row above the lines, where there is room for their letters
function plot(box, worth, promised, narrow) {
  const picture = at('capture-plot'), draw = (name, values, text = '') => {
    const e = document.createElementNS('http://www.w3.org/2000/svg', name);
    for (const [key, value] of Object.entries(values)) e.setAttribute(key, value);
    e.textContent = text; picture.append(e);
  };
  const left = narrow ? 44 : 60, right = narrow ? 344 : 490;
  picture.replaceChildren(); picture.setAttribute('viewBox', `0 0 ${narrow ? 360 : 700} 260`);
  const values = [...worth, ...(promised ? [promised] : [])].flatMap((w) => LINES.map((k) => w[`${k}_mm`])).filter((v) => v > 0);
  picture.parentElement.firstElementChild.hidden = picture.toggleAttribute('hidden', !values.length);
  if (!values.length) return;
  const low = Math.floor(Math.log10(Math.min(...values))), high = Math.ceil(Math.log10(Math.max(...values)) + 1e-9);
  const most = Math.max(promised?.readings ?? 0, worth.at(-1)?.readings ?? 0, 2);
  const x = (n) => left + (right - left) * (n / most), y = (v) => 225 - (narrow ? 190 : 200) * (Math.log10(v) - low) / Math.max(high - low, 1);
  for (let ten = low; ten <= high; ten++) { draw('line', {x1: left, x2: right, y1: y(10 ** ten), y2: y(10 ** ten)}); draw('text', {x: left - 8, y: y(10 ** ten) + 5, 'text-anchor': 'end'}, own(+(10 ** ten).toPrecision(1))); }
  for (const n of [0, Math.round(most / 2), most]) draw('text', {x: x(n), y: 248, 'text-anchor': 'middle'}, String(n));
  const ends = [];
  for (const k of LINES) {
    const points = worth.filter((w) => w[`${k}_mm`] > 0).map((w) => [x(w.readings), y(w[`${k}_mm`])]);
    if (promised?.[`${k}_mm`] > 0) draw('line', {x1: left, x2: right, y1: y(promised[`${k}_mm`]), y2: y(promised[`${k}_mm`]), class: `promised ${k}`});
    if (points.length) {
      draw('polyline', {points: points.map((p) => p.join(',')).join(' '), class: k});
      for (const [px, py] of points) draw('circle', {cx: px, cy: py, r: 3.5, class: k});
    }
    const end = points.at(-1)?.[1] ?? (promised?.[`${k}_mm`] > 0 ? y(promised[`${k}_mm`]) : null);
    if (end !== null) ends.push([end, k]);
  }
  ends.sort((a, b) => a[0] - b[0]);
  if (narrow) {
    let across = 4;
    for (const [, k] of ends) { draw('text', {x: across, y: 13, class: `${k} above`}, box.dataset[k]); across += picture.lastChild.getComputedTextLength() + 7; }
    return;
  }
  ends.reduce((above, [py, k]) => { const place = Math.max(py + 5, above + 17); draw('text', {x: 498, y: Math.min(place, 240), class: k}, box.dataset[k]); return place; }, 0);
}
