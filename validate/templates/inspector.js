// Points at a pixel of a picture: both footprints on the texture, and their figures. No network, no library.
"use strict";
(() => {
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const floats = (text) => new Float32Array(bytes(text).buffer);
  const integers = (text) => new Int32Array(bytes(text).buffer);
  const load = (source) => new Promise((done) => { const i = new Image(); i.onload = () => done(i); i.src = source; });
  const short = (x) => (x === 0 ? "0" : Math.abs(x) >= 1e-3 && Math.abs(x) < 1e5 ? String(+x.toPrecision(4)) : x.toExponential(1));

  // Half axes and angle of the ellipse that the circle of radius 1/2 in pixels becomes: singular values of J / 2.
  const ellipse = ([a, b, c, d]) => {
    const plus = Math.hypot(a + d, c - b), minus = Math.hypot(a - d, c + b);
    const angle = Math.atan2(2 * (a * c + b * d), a * a + b * b - c * c - d * d) / 2;
    return { major: (plus + minus) / 4, minor: Math.abs(plus - minus) / 4, angle };
  };
  const level = ([a, b, c, d]) => Math.log2(Math.max(Math.hypot(a, c), Math.hypot(b, d), 1e-12));
  const distance = (j, k) => Math.hypot(...j.map((x, i) => x - k[i])) / Math.hypot(...k);

  async function start(figure) {
    const data = JSON.parse(figure.querySelector("script").textContent);
    const [shot, close] = figure.querySelectorAll("canvas");
    const [picture, texture] = await Promise.all([load(data.picture), load(data.texture)]);
    const place = new Int32Array(data.size * data.size).fill(-1);
    let count = 0;
    bytes(data.hit).forEach((hit, pixel) => { if (hit) place[pixel] = count++; });
    const routes = data.routes.map((r) => ({ ...r, uv: floats(r.uv), j: floats(r.jacobian), chart: integers(r.chart) }));
    let [x, y] = data.start;

    const look = (route, at) => ({
      uv: [route.uv[2 * at], route.uv[2 * at + 1]], j: Array.from(route.j.subarray(4 * at, 4 * at + 4)), chart: route.chart[at],
    });

    function drawPicture() {
      const g = shot.getContext("2d"), scale = shot.width / data.size;
      g.imageSmoothingEnabled = false;
      g.drawImage(picture, 0, 0, shot.width, shot.height);
      g.lineWidth = 2; g.strokeStyle = "#fff"; g.strokeRect((x - 2) * scale, (y - 2) * scale, 5 * scale, 5 * scale);
      g.lineWidth = 1; g.strokeStyle = "#000"; g.strokeRect((x - 2) * scale, (y - 2) * scale, 5 * scale, 5 * scale);
    }

    function drawTexture(seen) {
      const g = close.getContext("2d"), n = close.width;
      const reach = Math.max(...seen.map((s) => ellipse(s.j).major)), span = Math.min(Math.max(6 * reach, 72), data.texels);
      const middle = seen[seen.length - 1].uv, left = middle[0] * data.texels - span / 2, top = (1 - middle[1]) * data.texels - span / 2;
      g.setTransform(1, 0, 0, 1, 0, 0); g.fillStyle = "#8a939b"; g.fillRect(0, 0, n, n);
      g.imageSmoothingEnabled = false;
      const k = n / span;
      for (let i = -1; i <= 1; i++) for (let m = -1; m <= 1; m++) // the texture repeats
        g.drawImage(texture, (i * data.texels - left) * k, (m * data.texels - top) * k, data.texels * k, data.texels * k);
      seen.forEach((s, index) => {
        const e = ellipse(s.j), cx = (s.uv[0] * data.texels - left) * k, cy = ((1 - s.uv[1]) * data.texels - top) * k;
        g.beginPath(); g.ellipse(cx, cy, Math.max(e.major * k, 1), Math.max(e.minor * k, 1), -e.angle, 0, 2 * Math.PI);
        g.globalAlpha = 0.18; g.fillStyle = routes[index].colour; g.fill(); g.globalAlpha = 1;
        g.lineWidth = 4; g.strokeStyle = "rgba(255,255,255,.8)"; g.stroke();
        g.lineWidth = 2.2; g.setLineDash(routes[index].dash); g.strokeStyle = routes[index].colour; g.stroke(); g.setLineDash([]);
        const [a, b, c, d] = s.j;
        [[a, c], [b, d]].forEach(([u, v]) => { // the columns of J: a half pixel step to the right, and down
          g.beginPath(); g.moveTo(cx, cy); g.lineTo(cx + u * k / 2, cy - v * k / 2); g.lineWidth = 1.5; g.stroke();
        });
      });
      figure.querySelector(".span").textContent = `${short(span)} texels wide`;
    }

    function write(seen) {
      const truth = seen[seen.length - 1];
      const row = (title, values) => `<tr><th>${title}</th>${values.map((v) => `<td>${v}</td>`).join("")}</tr>`;
      const each = (f) => seen.map(f);
      figure.querySelector("tbody").innerHTML = [
        row("u, v", each((s) => `${s.uv[0].toFixed(4)}, ${s.uv[1].toFixed(4)}`)),
        row("chart", each((s) => s.chart)),
        row("level of detail", each((s) => level(s.j).toFixed(3))),
        row("footprint, texels", each((s) => { const e = ellipse(s.j); return `${short(2 * e.major)} × ${short(2 * e.minor)}`; })),
        row("major axis", each((s) => `${(ellipse(s.j).angle * 180 / Math.PI).toFixed(1)}°`)),
        row("LoD error", each((s) => (s === truth ? "truth" : short(Math.abs(level(s.j) - level(truth.j)))))),
        row("‖J − J*‖ / ‖J*‖", each((s) => (s === truth ? "truth" : short(distance(s.j, truth.j))))),
      ].join("");
    }

    function show() {
      const at = place[y * data.size + x];
      if (at < 0) return;
      const seen = routes.map((route) => look(route, at));
      drawPicture(); drawTexture(seen); write(seen);
      figure.querySelector(".where").textContent = `pixel ${x}, ${y}`;
    }
    function point(event) {
      const box = shot.getBoundingClientRect();
      const to = (from, start, length) => Math.min(Math.max(Math.floor((from - start) / length * data.size), 0), data.size - 1);
      const nx = to(event.clientX, box.left, box.width), ny = to(event.clientY, box.top, box.height);
      if (place[ny * data.size + nx] >= 0) { x = nx; y = ny; show(); }
    }
    shot.addEventListener("pointermove", point);
    shot.addEventListener("pointerdown", point);
    shot.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (!step) return;
      event.preventDefault();
      const nx = x + step[0], ny = y + step[1];
      if (nx >= 0 && ny >= 0 && nx < data.size && ny < data.size && place[ny * data.size + nx] >= 0) { x = nx; y = ny; show(); }
    });
    show();
  }
  document.querySelectorAll("figure.inspector").forEach(start);
})();
