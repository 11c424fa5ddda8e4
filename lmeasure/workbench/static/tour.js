// Points at what the tour speaks of; Escape ends it.
const bar = document.getElementById('tour'), found = document.querySelector(bar.dataset.at);
if (found) { found.classList.add('pointed'); found.scrollIntoView({block: 'center'}); }
document.addEventListener('keydown', (event) => { if (event.key === 'Escape') location.href = bar.querySelector('[data-end]').href; });
bar.querySelector('[data-next]')?.focus({preventScroll: true});
