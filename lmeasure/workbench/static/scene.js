// The rig in space: observation points, cables and the tool; drag to turn, drag a point to move it in the plane of the screen.
import {number, numbers} from './number.js';
import {letters, root} from './root.js';
const HIT = 12;

export async function draw(place, form) {
  const answer = await fetch(`${root}/scene?file=${encodeURIComponent(place.dataset.file)}`);
  const rig = await answer.json();
  const reported = document.getElementById('scene-reported');
  if (rig.error) { reported.textContent = rig.error; return; }
  const canvas = place.querySelector('canvas'), pen = canvas.getContext('2d');
  let turn = -0.6, lift = 0.45, held = null, last = null;
  const all = [...rig.points.map((p) => p.position_mm), ...Object.values(rig.tool)];
  const middle = [0, 1, 2].map((i) => all.reduce((sum, p) => sum + p[i], 0) / all.length);
  const reach = Math.max(...all.map((p) => Math.hypot(...p.map((v, i) => v - middle[i])))) || 1;
  const axes = () => {
    const [c, s, cl, sl] = [Math.cos(turn), Math.sin(turn), Math.cos(lift), Math.sin(lift)];
    return {right: [c, s, 0], up: [s * sl, -c * sl, cl]};
  };
  const scale = () => 0.44 * Math.min(canvas.clientWidth, canvas.clientHeight) / reach;
  const screen = (p) => {
    const {right, up} = axes(), d = p.map((v, i) => v - middle[i]), k = scale();
    const dot = (a) => a[0] * d[0] + a[1] * d[1] + a[2] * d[2];
    return [canvas.clientWidth / 2 + k * dot(right), canvas.clientHeight / 2 - k * dot(up)];
  };
  const paint = () => {
    const style = getComputedStyle(document.body), ratio = devicePixelRatio || 1;
    canvas.width = canvas.clientWidth * ratio; canvas.height = canvas.clientHeight * ratio;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0); pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.font = letters(0.875); pen.strokeStyle = pen.fillStyle = style.getPropertyValue('--ink') || '#000';
    const stroke = (a, b, colour, width) => { pen.beginPath(); pen.strokeStyle = colour; pen.lineWidth = width; pen.moveTo(...screen(a)); pen.lineTo(...screen(b)); pen.stroke(); };
    [['X', '--bad', [1, 0, 0]], ['Y', '--good', [0, 1, 0]], ['Z', '--act', [0, 0, 1]]].forEach(([name, its, way]) => {
      const colour = style.getPropertyValue(its);
      const end = way.map((v) => v * reach * 0.3); stroke([0, 0, 0], end, colour, 2); pen.fillStyle = colour; pen.fillText(name, ...screen(end));
    });
    const at = Object.fromEntries(rig.points.map((p) => [p.name, p.position_mm]));
    for (const c of rig.cables) if (at[c.from] && rig.tool[c.to]) stroke(at[c.from], rig.tool[c.to], style.getPropertyValue('--soft'), 1.5);
    for (const [name, p] of Object.entries(rig.tool)) { pen.fillStyle = '#c2410c'; pen.beginPath(); pen.arc(...screen(p), 3, 0, 7); pen.fill(); }
    rig.points.forEach((p, i) => {
      pen.fillStyle = style.getPropertyValue(i === held ? '--bad' : '--act'); const [x, y] = screen(p.position_mm);
      pen.beginPath(); pen.arc(x, y, 7, 0, 7); pen.fill(); pen.fillText(p.name, x + 10, y - 8);
    });
  };
  const moved = (i) => {
    const p = rig.points[i]; reported.textContent = `${p.name}: ${numbers(p.position_mm, 1)}\u00a0${document.body.dataset.mm}`;
    p.position_mm.forEach((v, axis) => {
      const input = form.elements[`observation_point.${i}.position_mm.${axis}`];
      if (input) input.value = String(+(document.getElementById('inches').checked ? v / 25.4 : v).toFixed(6));
    });
  };
  const where = document.getElementById('scene-zone');
  let asking = false, again = false;
  // the first time on a machine it takes long, and says why
  const compiled = async () => {
    const now = await (await fetch(`${root}/compiling`)).json();
    if (asking && now.name) where.textContent = where.dataset.compiling.replace('{name}', now.name).replace('{seconds}', now.seconds.toFixed(0));
  };
  const judge = async () => {
    if (asking) { again = true; return; }
    asking = true;
    const patience = setInterval(compiled, 500);
    try {
      const points = Object.fromEntries(rig.points.map((p) => [p.name, p.position_mm]));
      const answer = await fetch(`${root}/coarse`, {method: 'POST', headers: {'Content-Type': 'application/json'}, body: JSON.stringify({file: place.dataset.file, points})});
      const found = await answer.json();
      const figures = {volume: number(found.zone_volume_mm3 / 1e9, 2), angle: number(found.least_angle_deg, 1), u95: number(found.median_u95_mm, 3)};
      // a number and its unit stand in one line
      where.textContent = found.error ?? where.dataset.figures.replace(/{(\w+)}/g, (_, name) => figures[name]).replace(/(\d) (?=[^\s\d])/g, '$1\u00a0');
    } finally { asking = false; clearInterval(patience); }
    if (again) { again = false; judge(); }
  };
  judge();
  canvas.addEventListener('pointerdown', (event) => {
    const near = rig.points.map((p, i) => [Math.hypot(screen(p.position_mm)[0] - event.offsetX, screen(p.position_mm)[1] - event.offsetY), i]).sort((a, b) => a[0] - b[0])[0];
    held = near && near[0] < HIT ? near[1] : null; last = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); paint();
  });
  canvas.addEventListener('pointermove', (event) => {
    if (!last) return;
    const dx = event.clientX - last[0], dy = event.clientY - last[1]; last = [event.clientX, event.clientY];
    if (held === null) { turn -= dx / 150; lift = Math.max(-1.5, Math.min(1.5, lift + dy / 150)); }
    else {
      const {right, up} = axes(), k = scale();
      rig.points[held].position_mm = rig.points[held].position_mm.map((v, i) => Math.round(10 * (v + (right[i] * dx - up[i] * dy) / k)) / 10);
      moved(held); judge();
    }
    paint();
  });
  canvas.addEventListener('pointerup', () => { last = null; held = null; paint(); });
  canvas.addEventListener('keydown', (event) => {
    const step = {ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1]}[event.key];
    if (step) { event.preventDefault(); turn += step[0]; lift += step[1]; paint(); }
  });
  // the drawing follows what is typed; how good the zone is follows once it is put in
  const typed = (key, before) => {
    const input = form.elements[key], value = Number(input?.value.replace(',', '.')) * (document.getElementById('inches').checked ? 25.4 : 1);
    return input?.value.trim() && Number.isFinite(value) ? value : before;
  };
  const follow = () => {
    rig.points.forEach((p, i) => { p.position_mm = p.position_mm.map((v, axis) => typed(`observation_point.${i}.position_mm.${axis}`, v)); p.name = form.elements[`observation_point.${i}.name`]?.value || p.name; });
    for (const [name, p] of Object.entries(rig.tool)) rig.tool[name] = p.map((v, axis) => typed(`tool.${name}.${axis}`, v));
    rig.cables.forEach((c, i) => { for (const end of ['from', 'to']) c[end] = form.elements[`cable.${i}.${end}`]?.value ?? c[end]; });
    paint();
  };
  form.addEventListener('input', follow);
  form.addEventListener('change', () => { follow(); judge(); });
  follow();
  new ResizeObserver(paint).observe(canvas); matchMedia('(prefers-color-scheme: dark)').addEventListener('change', paint); paint();
}
