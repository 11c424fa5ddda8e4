// Every page works without this; with it, command lines, progress and live values renew themselves.
import {gone, parts} from './bus.js';
import {root} from './root.js';

const post = (address, form) => fetch(address, {method: 'POST', body: new URLSearchParams(form), headers: {'Accept': 'application/json'}});

// on a telephone the row of pages is pushed aside
const row = document.querySelector('header nav'), here = row?.querySelector('[aria-current]');
if (here) row.scrollLeft = here.offsetLeft - row.offsetLeft - (row.clientWidth - here.offsetWidth) / 2;
row?.addEventListener('focusin', (event) => event.target.scrollIntoView({block: 'nearest', inline: 'nearest'}));


for (const form of document.querySelectorAll('form[data-command]')) {
  let waiting;
  const renew = async () => {
    const answer = await post(`${root}/line/${form.dataset.command}`, new FormData(form)).catch(() => null);
    gone(answer === null);
    if (answer === null) return;
    const reported = await answer.json();
    form.querySelector('[data-line]').replaceChildren(...parts(reported.line));
    const why = form.querySelector('[data-hindered]'), button = form.querySelector('button.go');
    button.disabled = why.parentElement.parentElement.querySelector('p.needs:not([data-hindered])') !== null || Boolean(reported.hindered);
    why.hidden = !reported.hindered; why.firstElementChild.textContent = reported.hindered ?? ''; why.lastElementChild.href = reported.mend ? root + reported.mend : '#';
  };
  form.addEventListener('input', () => { clearTimeout(waiting); waiting = setTimeout(renew, 150); });
  renew();
}

// A link to a part opens it.
const open = () => { const part = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1))); if (part?.tagName === 'DETAILS') { part.open = true; part.scrollIntoView(); } };
addEventListener('hashchange', open);
open();

const job = document.getElementById('job');
if (job && job.dataset.state === 'running') follow(job.dataset.number);

function follow(number) {
  const at = (id) => document.getElementById(id);
  const log = at('log');
  const line = (text, kind) => {
    const one = document.createElement('li');
    one.textContent = text; one.className = kind; log.append(one);
    while (log.children.length > 500) log.firstChild.remove();
    log.scrollTop = log.scrollHeight;
  };
  // what began is at work: no word on compiling, no bar without a measure
  const begun = () => { at('doing').textContent = ''; at('progress').hidden = !at('progress').hasAttribute('value'); };
  // how long the rest takes at the pace so far, once that is known
  let first = null;
  const left = (fraction) => {
    const now = performance.now() / 1000;
    if (first === null || fraction < first.fraction) first = {fraction, now};
    const [done, seconds] = [fraction - first.fraction, now - first.now];
    if (seconds < 3 || done < 0.02) return '';
    const rest = seconds * (1 - fraction) / done, words = at('left').dataset;
    return rest < 100 ? words.seconds.replace('{n}', Math.ceil(rest / 5) * 5) : words.minutes.replace('{n}', Math.ceil(rest / 60));
  };
  const reported = {
    live: begun,
    capture: begun,
    progress: (e) => { at('progress').value = e.fraction; at('doing').textContent = e.text; at('left').textContent = left(e.fraction); },
    compiling: (e) => { const text = at('doing').dataset.compiling.replace('{name}', e.text); at('doing').textContent = text; line(text, 'said'); },
    said: (e) => line(e.text, 'said'),
    typed: (e) => { if (e.text) line(`> ${e.text}`, 'typed'); at('asked').hidden = true; at('typing').classList.remove('question'); steps(false); },
    state: (e) => { at('now').hidden = false; at('now').textContent = e.text; at('typing').hidden = false; },
    asked: (e) => { at('typing').classList.add('question'); at('asked').hidden = false; at('asked').textContent = e.of ? `${e.number}/${e.of}  ${e.text}` : e.text; at('typing').hidden = false; if (e.of) at('progress').value = (e.number - 1) / e.of; steps(true); },
    end: async () => { source.close(); if (await fetch(location.href).then((a) => a.ok, () => false)) location.reload(); else gone(true); },
  };
  const source = new EventSource(`${root}/jobs/${number}/events`);
  source.onopen = () => { log.replaceChildren(); gone(false); };
  source.onerror = () => gone(true);
  source.onmessage = (message) => { const event = JSON.parse(message.data); reported[event.event]?.(event); document.dispatchEvent(new CustomEvent('reported', {detail: event})); };
  const type = (text) => post(`${root}/jobs/${number}/type`, {line: text}).catch(() => gone(true));
  // a step of a self-test is answered once it is asked, and by a double click once
  const steps = (asked) => { if (job.dataset.command === 'check') for (const b of at('typing').querySelectorAll('[data-type]')) b.disabled = !asked; };
  job.addEventListener('click', (event) => {
    const button = event.target.closest('[data-type]');
    if (!button || (event.detail > 1 && !button.dataset.type)) return;
    steps(false);
    type(button.dataset.type);
  });
  at('answer')?.addEventListener('submit', (event) => { event.preventDefault(); type(at('said').value); at('said').value = ''; });
  at('cancel')?.addEventListener('click', () => { at('cancel').disabled = true; post(`${root}/jobs/${number}/cancel`, {}).catch(() => gone(true)); });
}

for (const drop of document.querySelectorAll('form.drop')) {
  const input = drop.querySelector('input[type=file]');
  for (const kind of ['dragover', 'dragleave', 'drop'])
    drop.addEventListener(kind, (event) => {
      event.preventDefault(); drop.classList.toggle('over', kind === 'dragover');
      if (kind === 'drop') taken(drop, input, event.dataTransfer);
    });
}

// a folder that is dropped is sent with the names that its files have in it
async function taken(drop, input, held) {
  const roots = [...held.items].map((item) => item.webkitGetAsEntry?.()).filter((entry) => entry?.isDirectory);
  if (!roots.length) { input.files = held.files; drop.submit(); return; }
  const data = new FormData(drop); data.delete('files');
  const walk = async (entry, before) => {
    const name = before + entry.name;
    if (entry.isFile) { data.append('files', await new Promise((done, failed) => entry.file(done, failed)), name); return; }
    const reader = entry.createReader();
    for (;;) {
      const some = await new Promise((done, failed) => reader.readEntries(done, failed));
      if (!some.length) return;
      for (const one of some) await walk(one, `${name}/`);
    }
  };
  for (const root of roots) await walk(root, '');
  const answer = await fetch(drop.action, {method: 'POST', body: data});
  if (answer.redirected) location.href = answer.url; else document.documentElement.innerHTML = await answer.text();
}

const rig = document.getElementById('rig-form');
if (rig) {
  const texts = [...document.querySelectorAll('#cable text')];
  const light = (name) => texts.forEach((t) => t.classList.toggle('lit', name !== '' && t.textContent.trim() === name));
  rig.addEventListener('focusin', (event) => light(event.target.dataset.arrow ?? ''));
  const inches = document.getElementById('inches');
  inches.addEventListener('change', () => {
    for (const input of rig.querySelectorAll('input[data-unit=mm]')) {
      if (inches.checked) { input.dataset.mm = input.value; input.dataset.shown = input.value = String(+(input.value / 25.4).toPrecision(9)); }
      else input.value = input.value === input.dataset.shown ? input.dataset.mm : String(+(input.value * 25.4).toPrecision(12));
    }
    for (const input of rig.querySelectorAll('input[data-unit=mm]')) { const unit = input.labels[0].querySelector('.unit'); unit.textContent = inches.checked ? unit.dataset.in : unit.dataset.mm; }
  });
  rig.addEventListener('submit', () => { if (inches.checked) inches.click(); });
  if (document.getElementById('scene')) import('./scene.js').then((module) => module.draw(document.getElementById('scene'), rig));
}
