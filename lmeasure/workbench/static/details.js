// The details of a certificate as they will be printed, in both languages, while they are typed; lamps for what nobody states.
import {root} from './root.js';
const form = document.getElementById('details'), wrong = document.getElementById('wrong'), lacking = document.getElementById('lacking');
let waiting;

async function renew() {
  const answer = await fetch(`${root}/details/preview`, {method: 'POST', body: new URLSearchParams(new FormData(form))});
  const reported = await answer.json();
  wrong.hidden = !reported.complaints.length; wrong.textContent = reported.complaints.join('\n');
  lacking.textContent = lacking.dataset.template.replace('{count}', reported.missing.length);
  for (const lamp of form.querySelectorAll('[data-row]')) {
    const state = reported.missing.includes(lamp.dataset.row) ? 'red' : 'green';
    lamp.className = `lamp ${state}`; lamp.setAttribute('aria-label', lamp.dataset[state]);
  }
  for (const [language, [title, rows]] of Object.entries(reported.printed ?? {})) {
    document.querySelector(`[data-title=${language}]`).textContent = title;
    document.querySelector(`[data-printed=${language}]`).replaceChildren(...rows.map((cells) => {
      const row = document.createElement('tr');
      cells.forEach((text, i) => { const cell = document.createElement(i ? 'td' : 'th'); if (!i) cell.scope = 'row'; cell.textContent = text; row.append(cell); });
      return row;
    }));
  }
}

form.addEventListener('input', () => { clearTimeout(waiting); waiting = setTimeout(renew, 200); });
renew();
