// What was typed and not yet sent outlives a reload and the button back, in this tab alone.
const again = ['reload', 'back_forward'].includes(performance.getEntriesByType('navigation')[0]?.type);
const typed = (form) => [...form.elements].filter((e) => e.name && !e.name.startsWith('_') && !['hidden', 'file', 'submit'].includes(e.type));

for (const form of document.querySelectorAll('form[data-command], #rig-form, #details')) {
  const key = `${location.pathname}${location.search}#${form.dataset.command ?? form.id}`;
  const kept = again && sessionStorage.getItem(key);
  if (kept) {
    const values = JSON.parse(kept), fold = form.closest('details');
    if (fold) fold.open = true;
    for (const field of typed(form)) {
      if (!(field.name in values)) continue;
      const part = field.closest('details.part');
      if (part && values[field.name] !== field.value) part.open = true;
      if (field.type === 'checkbox') field.checked = values[field.name]; else field.value = values[field.name];
    }
    for (const kind of ['input', 'change']) form.dispatchEvent(new Event(kind, {bubbles: true}));
  }
  form.addEventListener('input', () => {
    const inches = form.id === 'rig-form' && document.getElementById('inches').checked;
    if (!inches) sessionStorage.setItem(key, JSON.stringify(Object.fromEntries(typed(form).map((e) => [e.name, e.type === 'checkbox' ? e.checked : e.value]))));
  });
}
