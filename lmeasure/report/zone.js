(() => {
  const data = JSON.parse(document.getElementById("zone-data").textContent);
  const read = (text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  };
  const worst = read(data.worst_angle), u95 = read(data.u95), others = read(data.others);
  const covariance = read(data.covariance), weakest = read(data.weakest), angle = read(data.angle);
  const [nx, ny, nz] = [data.x.length, data.y.length, data.z.length];
  const at = (i, j, k) => (i * ny + j) * nz + k;
  const id = (name) => document.getElementById(name);
  const [low, high] = data.range_u95.map(Math.log10);
  const place = { i: nx >> 1, j: ny >> 1 };

  const words = data.words;
  const printed = (v) => String(v).replace(".", data.mark).replace("-", "−");
  const digits = (v) => (Number.isFinite(v) ? printed(v.toPrecision(3)) : words.unknown);
  const filled = (text, values) => text.replace(/\[(\w+)\]/g, (_, name) => values[name]);
  const limits = () => {
    const part = Number(id("u95").value) / 1000;
    // the slider's end asks nothing unless a limit was asked for
    const free = part === 1 && !data.asked_u95;
    // as it is printed, so that `zone --u95-mm` with the figure that is read gives the same zone; the end is the limit that was asked for
    const limit = part === 1 ? data.range_u95[1] : Number((10 ** (low + part * (high - low))).toPrecision(3));
    return { level: Number(id("level").value), angle: Number(id("angle").value), u95: free ? Infinity : limit };
  };
  // positive in the zone, negative outside, 0 on its edge
  const margin = (n, asked) => {
    if (!others[n] || !Number.isFinite(u95[n])) return -1;
    const byAngle = (asked.angle - worst[n]) / 90;
    return Number.isFinite(asked.u95) ? Math.min(byAngle, Math.log10(asked.u95 / u95[n])) : byAngle;
  };
  const layer = (value, k) => {
    const rows = [];
    for (let j = 0; j < ny; j++) {
      const row = [];
      for (let i = 0; i < nx; i++) row.push(value(at(i, j, k)));
      rows.push(row);
    }
    return rows;
  };
  const finite = (v) => (Number.isFinite(v) ? v : null);

  const draw = () => {
    const asked = limits();
    id("level-reported").textContent = printed(data.z[asked.level]) + words.mm;
    id("angle-reported").textContent = `${printed(asked.angle)}°`;
    id("u95-reported").textContent = Number.isFinite(asked.u95) ? digits(asked.u95) + words.mm : words.any;
    let inside = 0;
    for (let n = 0; n < worst.length; n++) inside += margin(n, asked) >= 0;
    const volume = (inside * data.spacing[0] * data.spacing[1] * data.spacing[2]) / 1e9;
    id("left").textContent = filled(words.left, { inside, of: worst.length, volume: digits(volume) });
    const edge = layer((n) => margin(n, asked), asked.level);
    const maps = { "map-angle": (n) => worst[n], "map-u95": (n) => finite(Math.log10(u95[n])) };
    for (const [name, value] of Object.entries(maps)) {
      const marked = [[data.x[place.i]], [data.y[place.j]]];
      Plotly.restyle(name, { z: [layer(value, asked.level)] }, [0]);
      Plotly.restyle(name, { z: [edge] }, [1]);
      Plotly.restyle(name, { x: [marked[0]], y: [marked[1]] }, [2]);
    }
    tell(asked);
  };

  const tell = (asked) => {
    const n = at(place.i, place.j, asked.level);
    const here = [data.x[place.i], data.y[place.j], data.z[asked.level]];
    const c = covariance.slice(6 * n, 6 * n + 6);
    const reported = Number.isFinite(c[0]);
    const cable = data.cables[weakest[n]];
    const between = data.mark === "," ? "; " : ", ";
    const rows = [
      [words.place, `(${here.map(printed).join(between)})${words.mm}`],
      [words.inside, margin(n, asked) >= 0 ? words.yes : words.no],
      [words.angle, `${printed(worst[n].toFixed(1))}°`],
      [words.u95, Number.isFinite(u95[n]) ? digits(u95[n]) + words.mm : words.unknown],
      [words.weakest, reported ? filled(words.cable, { name: cable.name, angle: printed(angle[n].toFixed(1)) }) : words.stuck],
    ];
    const table = document.createElement("table");
    for (const row of rows) {
      const line = table.insertRow();
      for (const text of row) line.insertCell().textContent = text;
    }
    const box = document.createElement("div");
    box.className = "scroll text";
    box.append(table);
    id("place").replaceChildren(box);
    const empty = { x: [[]], y: [[]], z: [[]] };
    if (!reported) {
      Plotly.restyle("ellipsoid", empty, [0]);
      Plotly.restyle("ellipsoid", empty, [1]);
      return;
    }
    // Cholesky: points of the unit sphere times the root of the covariance
    const [xx, yy, zz, xy, xz, yz] = c;
    const root = (v) => Math.sqrt(Math.max(v, 0));
    const a = root(xx), b = xy / a, d = xz / a, e = root(yy - b * b), f = (yz - b * d) / (e || 1), g = root(zz - d * d - f * f);
    const shell = { x: [], y: [], z: [] };
    for (let p = 0; p <= 24; p++) {
      const rows3 = [[], [], []];
      for (let q = 0; q <= 48; q++) {
        const [t, h] = [(Math.PI * p) / 24, (2 * Math.PI * q) / 48];
        const s = [Math.sin(t) * Math.cos(h), Math.sin(t) * Math.sin(h), Math.cos(t)].map((v) => v * data.radius);
        rows3[0].push(a * s[0]);
        rows3[1].push(b * s[0] + e * s[1]);
        rows3[2].push(d * s[0] + f * s[1] + g * s[2]);
      }
      shell.x.push(rows3[0]);
      shell.y.push(rows3[1]);
      shell.z.push(rows3[2]);
    }
    const way = cable.base.map((v, k) => v - here[k]);
    const length = Math.hypot(...way) || 1;
    const size = data.radius * Math.sqrt(xx + yy + zz);
    const line = way.map((v) => [0, (v / length) * size]);
    // figures at the corner of two axes would touch: of each side its middle and what is half way to its ends
    const half = [xx, yy, zz].map((v) => Number((0.5 * data.radius * root(v)).toPrecision(1)));
    const marks = {};
    "xyz".split("").forEach((axis, k) => (marks[`scene.${axis}axis.tickvals`] = [-half[k], 0, half[k]]));
    Plotly.relayout("ellipsoid", marks);
    Plotly.restyle("ellipsoid", { x: [shell.x], y: [shell.y], z: [shell.z] }, [0]);
    Plotly.restyle("ellipsoid", { x: [line[0]], y: [line[1]], z: [line[2]] }, [1]);
  };

  for (const name of ["level", "angle", "u95"]) id(name).addEventListener("input", draw);
  const nearest = (values, v) => values.reduce((best, value, k) => (Math.abs(value - v) < Math.abs(values[best] - v) ? k : best), 0);
  const start = () => {
    // each was drawn before those beside it took their room
    for (const name of ["map-angle", "map-u95", "ellipsoid"]) Plotly.Plots.resize(name);
    for (const name of ["map-angle", "map-u95"]) {
      id(name).on("plotly_click", (event) => {
        const point = event.points[0];
        place.i = nearest(data.x, point.x);
        place.j = nearest(data.y, point.y);
        draw();
      });
    }
    draw();
  };
  if (document.readyState === "complete") start();
  else window.addEventListener("load", start);
})();
