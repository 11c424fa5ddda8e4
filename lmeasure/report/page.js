(() => {
  // A plot follows the size of its place, whatever changes that: the window, a fold, zoom. By itself it follows the window alone.
  // Its letters follow those of the page in size and colour, and its height, where it has one of its own, follows its letters.
  const plots = document.querySelectorAll('.plotly-graph-div');
  const sheet = (plot) => (plot.closest('.parts') ? 360 : plot.closest('.scene') ? 420 : 880); // height on paper, where two parts share a sheet
  const wall = matchMedia('(min-width: 190rem)'), dark = matchMedia('(prefers-color-scheme: dark)');
  const paper = () => document.body.classList.contains('paper');
  const fit = (plot) => {
    const drawn = plot._fullLayout, size = wall.matches && !paper() ? 15 : 12, ink = paper() ? '#16202a' : getComputedStyle(document.body).color;
    if (!drawn || !plot.clientWidth) return;
    const box = plot.parentElement; // has the height: plotly forgets that of a layout when it fits the width
    let own = box.style.height.endsWith('px') ? parseFloat(box.style.height) : 0;
    if (plot.high && !paper()) [own, plot.high] = [plot.high, 0];
    own *= size / drawn.font.size;
    if (paper() && own > sheet(plot)) [plot.high, own] = [own, sheet(plot)];
    if (own) box.style.height = `${own}px`;
    if (own && plot.layout.height) plot.layout.height = own;
    const high = (own || plot.closest('.scene')) && Math.abs(plot.clientHeight - drawn.height) > 0.6;
    if (high || plot.clientWidth !== Math.round(drawn.width) || size !== drawn.font.size || plot.layout.font?.color !== ink)
      Plotly.relayout(plot, { autosize: true, 'font.size': size, 'font.color': ink }); // at once: `Plots.resize` waits for a tenth of a second
  };
  const all = () => plots.forEach(fit);
  const places = new ResizeObserver((seen) => seen.forEach(({ target }) => fit(target)));
  for (const plot of plots) places.observe(plot);
  dark.addEventListener('change', all);
  // A link to a part opens it.
  const open = () => { const part = document.getElementById(decodeURIComponent(location.hash.slice(1))); if (part?.tagName === 'DETAILS') part.open = true; };
  addEventListener('hashchange', open);
  open();
  // Paper has every part open, and is narrower than most windows; a script has no turn between the command to print and the sheet.
  let closed = [];
  const print = (on) => {
    if (on) closed = [...document.querySelectorAll('details:not([open])')];
    for (const part of closed) part.open = on;
    document.body.classList.toggle('paper', on);
    for (const plot of plots) {
      const scene = plot.closest('.scene');
      if (scene) scene.style.maxHeight = scene.style.minHeight = on ? `${sheet(plot)}px` : '';
      fit(plot);
    }
  };
  addEventListener('beforeprint', () => print(true));
  addEventListener('afterprint', () => print(false));
})();
