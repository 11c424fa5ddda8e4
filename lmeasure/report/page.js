(() => {
  // On a wide screen sections fill two columns, each where there is room first: a row of the grid is a few pixels high, and a section takes
  // as many as it is high.
  const main = document.querySelector('main'), sections = document.querySelectorAll('main > section'), step = 4;
  const settle = () => {
    for (const section of sections) section.style.gridRowEnd = `span ${Math.ceil(section.getBoundingClientRect().height / step)}`;
  };
  if (main) {
    main.classList.add('placed');
    const heights = new ResizeObserver(settle);
    for (const section of sections) heights.observe(section);
    settle();
  }
  // A plot follows the size of its place, whatever changes that: columns, the window, a fold, zoom. By itself it follows the window alone.
  // Its letters follow those of the page, and its height, where it has one of its own, follows its letters.
  const plots = document.querySelectorAll('.plotly-graph-div');
  const wall = matchMedia('(min-width: 190rem)');
  const fit = (plot) => {
    const drawn = plot._fullLayout, size = wall.matches && !document.body.classList.contains('paper') ? 15 : 12;
    if (!drawn || !plot.clientWidth) return;
    if (size !== drawn.font.size && plot.layout.height) {
      plot.layout.height *= size / drawn.font.size;
      plot.style.height = `${plot.layout.height}px`;
    }
    const high = drawn.autosize && plot.clientHeight !== Math.round(drawn.height) && plot.closest('.scene');
    if (high || plot.clientWidth !== Math.round(drawn.width) || size !== drawn.font.size)
      Plotly.relayout(plot, { autosize: true, 'font.size': size }); // at once: `Plots.resize` waits for a tenth of a second
  };
  const places = new ResizeObserver((seen) => seen.forEach(({ target }) => fit(target)));
  for (const plot of plots) places.observe(plot);
  // Paper is narrower than most windows, and a script has no turn between the command to print and the sheet.
  const print = (on) => {
    document.body.classList.toggle('paper', on);
    for (const plot of plots) {
      const scene = plot.closest('.scene');
      if (scene) scene.style.maxHeight = on ? '420px' : '';
      if (scene) scene.style.minHeight = on ? '420px' : '';
      fit(plot);
    }
  };
  addEventListener('beforeprint', () => print(true));
  addEventListener('afterprint', () => print(false));
})();
