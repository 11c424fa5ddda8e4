// On a wide screen sections fill two columns, each where there is room first: a row of the grid is a few pixels high, and a section takes
// as many as it is high.
(() => {
  const all = [...document.querySelectorAll('main > section')], step = 4;
  const settle = () => {
    for (const section of all) section.style.gridRowEnd = `span ${Math.ceil(section.getBoundingClientRect().height / step)}`;
  };
  document.querySelector('main').classList.add('placed');
  settle();
  const watch = new ResizeObserver(settle);
  for (const section of all) watch.observe(section);
})();
