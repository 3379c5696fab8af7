"use strict";
(() => {
  const $ = id => document.getElementById(id);
  const data = JSON.parse($("data").textContent);
  const MODES = ["swipe", "flicker", "side by side", "test", "reference", "FLIP", "bias", "relative"];

  // ---- Data ----------------------------------------------------------------------------------------------------------
  const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
  const halfTable = () => {
    const table = new Float32Array(65536);
    for (let h = 0; h < 65536; h++) {
      const e = h >> 10 & 31, m = h & 1023;
      const v = e === 0 ? m * 2 ** -24 : e === 31 ? (m ? NaN : Infinity) : (1 + m / 1024) * 2 ** (e - 15);
      table[h] = h & 0x8000 ? -v : v;
    }
    return table;
  };
  let halves = null;
  const floats = (text, isFloat) => {
    const buffer = bytes(text).buffer;
    if (isFloat) return new Float32Array(buffer);
    halves ??= halfTable();
    return Float32Array.from(new Uint16Array(buffer), h => halves[h]);
  };
  const magma = Array.from({ length: 256 }, (_, i) => {
    const at = i / 255 * 16, k = Math.min(15, Math.floor(at)), t = at - k;
    return data.magma[k].map((c, j) => Math.round(c + (data.magma[k + 1][j] - c) * t));
  });
  const redBlue = Array.from({ length: 256 }, (_, i) => {
    const s = (i - 127.5) / 127.5, t = Math.sqrt(Math.max(0, Math.abs(s) - 0.004)), end = s > 0 ? [178, 24, 43] : [33, 102, 172];
    return end.map(c => Math.round(247 + (c - 247) * t));
  });
  const encode = new Uint8ClampedArray(4097).map((_, i) => {
    const v = (i / 4096) ** 2; // finer near black
    return Math.round(255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055));
  });
  const luminance = (p, i) => 0.2126 * p[3 * i] + 0.7152 * p[3 * i + 1] + 0.0722 * p[3 * i + 2];

  // ---- State ---------------------------------------------------------------------------------------------------------
  const state = { mode: 0, layer: 0, zoom: 1, x: 0, y: 0, ev: 0, swipe: 0.5, phase: 0, cursor: null };
  const layers = data.layers.map(layer => ({ raw: layer, ready: null }));
  const view = $("view"), pen = view.getContext("2d");

  const current = () => {
    const entry = layers[state.layer];
    if (!entry.ready) {
      const { raw } = entry;
      entry.ready = {
        ...raw,
        test: floats(raw.test, raw.floats), reference: floats(raw.reference, raw.floats),
        flip: bytes(raw.flip), signed: bytes(raw.signed), pictures: {},
      };
    }
    return entry.ready;
  };

  const paint = (layer, colour) => {
    const canvas = document.createElement("canvas");
    canvas.width = layer.width; canvas.height = layer.height;
    const ctx = canvas.getContext("2d"), out = ctx.createImageData(layer.width, layer.height);
    for (let i = 0, n = layer.width * layer.height; i < n; i++) {
      colour(i, out.data, 4 * i);
      out.data[4 * i + 3] = 255;
    }
    ctx.putImageData(out, 0, 0);
    return canvas;
  };
  const exposed = (layer, plane) => {
    const gain = 2 ** state.ev;
    return paint(layer, (i, out, o) => {
      for (let k = 0; k < 3; k++) {
        const v = plane[3 * i + k] * gain;
        out[o + k] = encode[v > 0 ? Math.round(4096 * Math.sqrt(Math.min(1, v))) : 0];
      }
    });
  };
  const mapped = (layer, value, table) => paint(layer, (i, out, o) => {
    const c = table[value(i)];
    out[o] = c[0]; out[o + 1] = c[1]; out[o + 2] = c[2];
  });
  const relative = (layer, i) => {
    const t = luminance(layer.test, i), r = luminance(layer.reference, i), d = Math.abs(t - r);
    return d === 0 ? 0 : d / (r + 0.01 * layer.mean_luminance);
  };
  const picture = name => {
    const layer = current(), key = name === "test" || name === "reference" ? `${name} ${state.ev}` : name;
    if (layer.pictures[name]?.key !== key) {
      const canvas = name === "test" ? exposed(layer, layer.test)
        : name === "reference" ? exposed(layer, layer.reference)
        : name === "FLIP" ? mapped(layer, i => layer.flip[i], magma)
        : name === "bias" ? mapped(layer, i => layer.signed[i], redBlue)
        : mapped(layer, i => Math.min(255, Math.round(relative(layer, i) / 0.5 * 255)), magma);
      layer.pictures[name] = { key, canvas };
    }
    return layer.pictures[name].canvas;
  };

  // ---- Drawing -------------------------------------------------------------------------------------------------------
  // state.x, state.y is the image point in the middle of a pane; zoom is screen pixels per image pixel.
  const size = () => {
    const ratio = window.devicePixelRatio || 1, box = view.getBoundingClientRect();
    const w = Math.max(1, Math.round(box.width * ratio)), h = Math.max(1, Math.round(box.height * ratio));
    if (view.width !== w || view.height !== h) { view.width = w; view.height = h; }
    return { w, h, ratio };
  };
  const pane = () => {
    const { w, h, ratio } = size();
    return { w: MODES[state.mode] === "side by side" ? Math.floor((w - 4 * ratio) / 2) : w, h, ratio };
  };
  const drawOne = (image, left, width, h, ratio, centre) => {
    const scale = state.zoom * ratio;
    pen.imageSmoothingEnabled = scale < 1;
    pen.save();
    pen.beginPath(); pen.rect(left, 0, width, h); pen.clip();
    pen.drawImage(image, centre - state.x * scale, h / 2 - state.y * scale, image.width * scale, image.height * scale);
    pen.restore();
  };
  const label = (text, x, h, ratio, align) => {
    pen.font = `${12 * ratio}px system-ui, sans-serif`;
    const width = pen.measureText(text).width + 12 * ratio;
    const left = align === "right" ? x - width : x;
    pen.fillStyle = "rgba(0,0,0,.65)"; pen.fillRect(left, h - 22 * ratio, width, 22 * ratio);
    pen.fillStyle = "#fff"; pen.fillText(text, left + 6 * ratio, h - 7 * ratio);
  };
  const draw = () => {
    const { w, h, ratio } = size(), mode = MODES[state.mode], p = pane();
    pen.clearRect(0, 0, w, h);
    if (mode === "swipe") {
      const line = Math.round(w * state.swipe);
      drawOne(picture("test"), 0, line, h, ratio, w / 2);
      drawOne(picture("reference"), line, w - line, h, ratio, w / 2);
      pen.fillStyle = "#fff"; pen.fillRect(line - ratio, 0, 2 * ratio, h);
      pen.fillStyle = "#000"; pen.fillRect(line + ratio, 0, ratio, h);
      label("test", 0, h, ratio, "left"); label("reference", w, h, ratio, "right");
    } else if (mode === "side by side") {
      drawOne(picture("test"), 0, p.w, h, ratio, p.w / 2);
      drawOne(picture("reference"), w - p.w, p.w, h, ratio, w - p.w / 2);
      label("test", 0, h, ratio, "left"); label("reference", w, h, ratio, "right");
    } else {
      const name = mode === "flicker" ? (state.phase ? "reference" : "test") : mode;
      drawOne(picture(name), 0, w, h, ratio, w / 2);
      label(name, 0, h, ratio, "left");
    }
    if (state.cursor) {
      const scale = state.zoom * ratio, [cx, cy] = state.cursor;
      for (const centre of mode === "side by side" ? [p.w / 2, w - p.w / 2] : [w / 2]) {
        pen.strokeStyle = "#fff"; pen.lineWidth = 3 * ratio;
        const box = [centre + (cx - state.x) * scale, h / 2 + (cy - state.y) * scale, scale, scale];
        pen.strokeRect(...box);
        pen.strokeStyle = "#e0007a"; pen.lineWidth = ratio; pen.strokeRect(...box);
      }
    }
    Object.assign(view.dataset, { mode, zoom: state.zoom, ev: state.ev, swipe: state.swipe, x: state.x, y: state.y, phase: state.phase });
  };
  let pending = false;
  const redraw = () => {
    if (pending) return;
    pending = true;
    requestAnimationFrame(() => { pending = false; draw(); });
  };

  // ---- Read-out ------------------------------------------------------------------------------------------------------
  const text = v => !Number.isFinite(v) ? String(v) : v === 0 ? "0" : Math.abs(v) >= 1e5 || Math.abs(v) < 1e-4 ? v.toExponential(3) : v.toPrecision(4);
  const readOut = (x, y, aloud) => {
    const layer = current();
    x = Math.max(0, Math.min(layer.width - 1, Math.floor(x))); y = Math.max(0, Math.min(layer.height - 1, Math.floor(y)));
    state.cursor = [x, y];
    const i = y * layer.width + x, f = layer.factor;
    $("position").textContent = f === 1 ? `${x}, ${y}` : `${x * f}, ${y * f} (mean of ${f}×${f})`;
    const values = plane => [plane[3 * i], plane[3 * i + 1], plane[3 * i + 2], luminance(plane, i)];
    const t = values(layer.test), r = values(layer.reference);
    const fill = (id, row) => [...$(id).querySelectorAll("td")].forEach((cell, k) => { cell.textContent = text(row[k]); });
    fill("read-test", t); fill("read-reference", r); fill("read-ratio", t.map((v, k) => v === r[k] ? 1 : v / r[k]));
    $("read-flip").textContent = (layer.flip[i] / 255).toFixed(3);
    if (aloud) $("spoken").textContent = `Pixel ${x}, ${y}: test luminance ${text(t[3])}, reference ${text(r[3])}, FLIP ${(layer.flip[i] / 255).toFixed(2)}`;
    redraw();
  };

  // ---- Commands ------------------------------------------------------------------------------------------------------
  const fit = () => {
    const layer = current(), { w, h, ratio } = pane();
    state.zoom = Math.min(w / ratio / layer.width, h / ratio / layer.height);
    state.x = layer.width / 2; state.y = layer.height / 2;
    zoomed();
  };
  const zoomed = () => { $("zoom-value").textContent = `${Math.round(state.zoom * 100)} %`; redraw(); };
  const zoomBy = (factor, at) => {
    const layer = current(), before = state.zoom;
    state.zoom = Math.max(1 / 16, Math.min(64, state.zoom * factor));
    if (at) { // keep the image point under the pointer
      const change = 1 / before - 1 / state.zoom;
      state.x += at.dx * change; state.y += at.dy * change;
    }
    state.x = Math.max(0, Math.min(layer.width, state.x)); state.y = Math.max(0, Math.min(layer.height, state.y));
    zoomed();
  };
  const expose = ev => {
    state.ev = Math.max(-12, Math.min(12, Math.round(ev * 10) / 10));
    $("exposure").value = state.ev;
    $("exposure-value").textContent = `${state.ev >= 0 ? "+" : "−"}${Math.abs(state.ev).toFixed(1)} EV`;
    redraw();
  };
  const swipe = s => { state.swipe = Math.max(0, Math.min(1, s)); $("swipe").value = state.swipe; redraw(); };
  let timer = 0;
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  const show = index => {
    const split = m => MODES[m] === "side by side", refit = split(index) !== split(state.mode) && state.fitted;
    state.mode = index;
    [...$("modes").children].forEach((button, k) => button.setAttribute("aria-pressed", k === index));
    $("swipe-choice").hidden = MODES[index] !== "swipe";
    clearInterval(timer);
    if (MODES[index] === "flicker") timer = setInterval(() => { state.phase = 1 - state.phase; redraw(); }, still.matches ? 2000 : 500);
    const ramp = table => `linear-gradient(to right, ${table.filter((_, i) => i % 15 === 0).map(c => `rgb(${c})`).join(",")})`;
    const legends = { FLIP: ["0", magma, "1 FLIP"], bias: ["darker", redBlue, "brighter than the reference"], relative: ["0", magma, "50 % and more"] };
    const legend = legends[MODES[index]];
    $("legend").replaceChildren(...(legend ?? []).map(part => {
      const span = document.createElement("span");
      if (typeof part === "string") span.textContent = part; else span.style.background = ramp(part);
      return span;
    }));
    view.setAttribute("aria-label", `Pictures, view: ${MODES[index]}`);
    if (refit) fit();
    redraw();
  };
  const goTo = (x, y, zoom) => {
    const f = current().factor;
    state.x = x / f + 0.5; state.y = y / f + 0.5; state.zoom = Math.max(state.zoom, zoom); state.fitted = false;
    zoomed(); readOut(x / f, y / f, true); view.focus({ preventScroll: true }); view.scrollIntoView({ block: "nearest" });
  };
  const button = (parent, label, act) => {
    const b = document.createElement("button");
    b.type = "button"; b.textContent = label; b.addEventListener("click", act);
    parent.append(b);
    return b;
  };
  const choose = index => {
    state.layer = index;
    const layer = current();
    $("places").replaceChildren();
    layer.places.forEach(p => button($("places"), `${p.x}, ${p.y}: ${p.flip.toFixed(2)}`, () => goTo(p.x + (p.width >> 1), p.y + (p.height >> 1), 6)));
    if (!layer.places.length) $("places").textContent = "none";
    expose(layer.exposure);
    state.cursor = null; state.fitted = true;
    fit();
  };

  // ---- Wiring --------------------------------------------------------------------------------------------------------
  MODES.forEach((name, index) => button($("modes"), name, () => show(index)).setAttribute("accesskey", index + 1));
  layers.forEach(({ raw }, index) => $("layer").add(new Option(raw.name, index)));
  $("layer-choice").hidden = layers.length < 2;
  $("layer").addEventListener("change", event => choose(Number(event.target.value)));
  $("exposure").addEventListener("input", event => expose(Number(event.target.value)));
  $("swipe").addEventListener("input", event => swipe(Number(event.target.value)));
  $("zoom-in").addEventListener("click", () => { state.fitted = false; zoomBy(1.5); });
  $("zoom-out").addEventListener("click", () => { state.fitted = false; zoomBy(1 / 1.5); });
  $("fit").addEventListener("click", () => { state.fitted = true; fit(); });
  $("help").addEventListener("click", event => {
    const open = $("keys").hidden;
    $("keys").hidden = !open; event.target.setAttribute("aria-expanded", open);
  });
  $("theme").addEventListener("click", () => {
    const root = document.documentElement, dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
  });
  document.querySelectorAll(".place").forEach(b => b.addEventListener("click", () => goTo(Number(b.dataset.x), Number(b.dataset.y), 8)));

  const point = event => {
    const box = view.getBoundingClientRect(), p = pane(), width = p.w / p.ratio;
    let left = event.clientX - box.left;
    if (MODES[state.mode] === "side by side" && left > box.width / 2) left -= box.width - width;
    const dx = left - width / 2, dy = event.clientY - box.top - box.height / 2;
    return { dx, dy, x: state.x + dx / state.zoom, y: state.y + dy / state.zoom };
  };
  let drag = null;
  view.addEventListener("pointerdown", event => {
    const box = view.getBoundingClientRect(), line = box.left + box.width * state.swipe;
    drag = { swipe: MODES[state.mode] === "swipe" && Math.abs(event.clientX - line) < 8, x: event.clientX, y: event.clientY };
    view.setPointerCapture(event.pointerId);
  });
  view.addEventListener("pointermove", event => {
    if (drag?.swipe) {
      const box = view.getBoundingClientRect();
      swipe((event.clientX - box.left) / box.width);
    } else if (drag) {
      state.x -= (event.clientX - drag.x) / state.zoom; state.y -= (event.clientY - drag.y) / state.zoom;
      drag.x = event.clientX; drag.y = event.clientY; state.fitted = false;
      redraw();
    }
    const p = point(event);
    readOut(p.x, p.y, false);
  });
  view.addEventListener("pointerup", () => { drag = null; });
  view.addEventListener("pointercancel", () => { drag = null; });
  view.addEventListener("wheel", event => {
    event.preventDefault();
    state.fitted = false;
    zoomBy(2 ** (-event.deltaY / 400), point(event));
  }, { passive: false });

  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|BUTTON)$/.test(event.target.tagName)) return;
    const step = event.shiftKey ? 10 : 1, [cx, cy] = state.cursor ?? [Math.floor(state.x), Math.floor(state.y)];
    const keys = {
      "+": () => { state.fitted = false; zoomBy(1.5); }, "=": () => { state.fitted = false; zoomBy(1.5); },
      "-": () => { state.fitted = false; zoomBy(1 / 1.5); }, "0": () => { state.fitted = true; fit(); },
      "[": () => expose(state.ev - 0.5), "]": () => expose(state.ev + 0.5),
      ",": () => swipe(state.swipe - 0.02), ".": () => swipe(state.swipe + 0.02),
    };
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (event.target === view && moves[event.key]) {
      const [dx, dy] = moves[event.key];
      readOut(cx + dx * step, cy + dy * step, true);
      // Keep the read-out pixel in sight.
      const p = pane(), [x, y] = state.cursor, rx = p.w / p.ratio / 2 / state.zoom, ry = p.h / p.ratio / 2 / state.zoom;
      state.x = Math.max(x + 1 - rx, Math.min(x + rx, state.x)); state.y = Math.max(y + 1 - ry, Math.min(y + ry, state.y));
    } else if (keys[event.key]) keys[event.key]();
    else if (event.key >= "1" && event.key <= String(MODES.length)) show(Number(event.key) - 1);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(() => { if (state.fitted) fit(); else redraw(); }).observe(view);
  choose(0);
  show(0);
  draw();
})();
