(() => {
  const out = [], wide = innerWidth;
  if (document.documentElement.scrollWidth > wide) out.push(`the page is ${document.documentElement.scrollWidth} wide`);
  const shut = (e) => e.closest('details:not([open]) > :not(summary)');
  const shown = (e) => {
    if (shut(e)) return false;
    const box = e.getBoundingClientRect(), style = getComputedStyle(e);
    return box.width > 0.5 && box.height > 0.5 && style.visibility !== 'hidden' && style.display !== 'none' && Number(style.opacity) > 0.05;
  };
  // plots and drawings: words must lie apart and within the picture
  for (const picture of document.querySelectorAll('.js-plotly-plot, .drawn > svg, .bar > svg')) {
    const frame = picture.getBoundingClientRect();
    const words = [...picture.querySelectorAll('svg text, text')].filter((e) => shown(e) && e.textContent.trim()
      && !e.closest('.modebar, .hoverlayer, .updatemenu-dropdown-button-group'));
    const boxes = words.map((e) => [e.getBoundingClientRect(), e.textContent.trim().slice(0, 30)]);
    boxes.forEach(([a, text], i) => {
      const beyond = Math.max(frame.left - a.left, a.right - frame.right, frame.top - a.top, a.bottom - frame.bottom);
      const name = picture.id || picture.parentElement.parentElement.className;
      if (beyond > 2) out.push(`${name}: '${text}' is clipped by ${beyond.toFixed(1)}`);
      for (const [b, other] of boxes.slice(0, i)) {
        const x = Math.min(a.right, b.right) - Math.max(a.left, b.left), y = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (x > 2 && y > 3) out.push(`${picture.id}: '${text}' and '${other}' collide by ${x.toFixed(1)} x ${y.toFixed(1)}`);
      }
    });
  }
  // plots: as large as their places
  for (const plot of document.querySelectorAll('.js-plotly-plot')) {
    if (!plot.clientWidth || shut(plot)) continue; // in a part that is closed, and drawn anew when it opens
    const {width, height} = plot._fullLayout;
    if (Math.abs(width - plot.clientWidth) > 1) out.push(`${plot.id}: drawn ${width} wide in ${plot.clientWidth}`);
    if (plot.closest('.scene') && Math.abs(height - plot.clientHeight) > 1)
      out.push(`${plot.id}: drawn ${height} high in ${plot.clientHeight}`);
  }
  // sections: none over another, nothing of one beyond it
  const sections = [...document.querySelectorAll('main .first > *, main .details > *')].map((e) => [e, e.getBoundingClientRect(), e.textContent.trim()]);
  sections.forEach(([e, a, text], i) => {
    if (e.scrollWidth > e.clientWidth + 8) out.push(`section '${text.slice(0, 30)}' is ${e.scrollWidth} wide in ${e.clientWidth}`);
    for (const [, b, other] of sections.slice(0, i)) {
      const x = Math.min(a.right, b.right) - Math.max(a.left, b.left), y = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (x > 1 && y > 1) out.push(`sections '${text.slice(0, 30)}' and '${other.slice(0, 30)}' overlap`);
    }
  });
  // tables: on a desk nothing has to be pushed aside to be read
  for (const box of document.querySelectorAll('.scroll'))
    if (wide > 1000 && box.scrollWidth > box.clientWidth + 1) out.push(`table '${box.textContent.slice(0, 40)}' is cut off`);
  // a number, a name or a unit is in one piece: what may be broken is long, or has a hyphen
  for (const cell of document.querySelectorAll('td, th')) {
    if (shut(cell)) continue;
    const range = document.createRange(), walker = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) for (const found of walker.currentNode.data.matchAll(/[^\s–-]+/g)) {
      if (found[0].length > (/^\p{L}+$/u.test(found[0]) ? 16 : 11)) continue;
      range.setStart(walker.currentNode, found.index);
      range.setEnd(walker.currentNode, found.index + found[0].length);
      const tops = new Set([...range.getClientRects()].map((box) => Math.round(box.top)));
      if (tops.size > 1) out.push(`'${found[0]}' of '${cell.textContent.slice(0, 30)}' is broken`);
    }
  }
  // what belongs together stands in one line: a number and its unit, an option, a date, a ratio
  for (const e of document.querySelectorAll('p, li, td, th, h1, h2, h3, small, figcaption')) {
    if (shut(e)) continue;
    const range = document.createRange(), walker = document.createTreeWalker(e, NodeFilter.SHOW_TEXT);
    const units = /[\d⁰¹²³⁴-⁹]\s(?:mm|мм|%|°|deg)(?![\wа-я])|\d\s[:×±]\s\d/gu;
    const whole = /--[a-z][\w-]*|(?<![\w-])\d{4}-\d\d-\d\d(?![\w-])|LM-[\dA-F-]{17}/gu;
    while (walker.nextNode()) for (const found of [units, whole].flatMap((all) => [...walker.currentNode.data.matchAll(all)])) {
      range.setStart(walker.currentNode, found.index);
      range.setEnd(walker.currentNode, found.index + found[0].length);
      const tops = new Set([...range.getClientRects()].map((box) => Math.round(box.top)));
      if (tops.size > 1) out.push(`'${found[0]}' of '${e.textContent.slice(0, 30)}' is in two lines`);
    }
  }
  for (const e of document.querySelectorAll('h1, h2, h3, p, li, td, th, small, label, figcaption')) {
    const box = e.getBoundingClientRect();
    if (shown(e) && !e.closest('.scroll') && (box.left < -1 || box.right > wide + 1)) out.push(`'${e.textContent.slice(0, 40)}' runs over`);
  }
  return out;
})()