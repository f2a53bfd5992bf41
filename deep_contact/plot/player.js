"use strict";
// Plays a run: player.py packs the states, and says what each column holds. `start` alone touches the document.

const player = (() => {
  const TURN = 2 * Math.PI / 65536;
  const STEPS = 65535;
  const SHADES = 32;
  const WIDEST = 6;  // of a force's line, pixels of the page
  const FIXED = [136, 136, 136], DARK = [34, 34, 34], LIGHT = [255, 255, 255];
  const PACES = [0.1, 0.2, 0.5, 1, 2, 5, 10];
  // Every sixteenth colour of viridis, which is linear enough between them.
  const VIRIDIS = "440154 481a6c 472f7d 414487 39568c 31688e 2a788e 23888e 1f988b 22a884 35b779 54c568 7ad151 a5db36 d2e21b fde725"
    .split(" ").map(hex => [0, 2, 4].map(at => parseInt(hex.slice(at, at + 2), 16)));

  function colourAt(share) {
    const place = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
    const low = Math.min(Math.floor(place), VIRIDIS.length - 2);
    return VIRIDIS[low].map((from, i) => Math.round(from + (place - low) * (VIRIDIS[low + 1][i] - from)));
  }

  const isLight = ([red, green, blue]) => 0.299 * red + 0.587 * green + 0.114 * blue > 127;
  const shades = Array.from({length: SHADES}, (_, i) => colourAt(i / (SHADES - 1)));

  // ---- numbers ----

  // Bytes in four planes -> signed integers.
  function unfold(bytes) {
    const count = bytes.length / 4, numbers = new Int32Array(count);
    for (let i = 0; i < count; i++) {
      const folded = bytes[i] | bytes[count + i] << 8 | bytes[2 * count + i] << 16 | bytes[3 * count + i] << 24;
      numbers[i] = (folded >>> 1) ^ -(folded & 1);
    }
    return numbers;
  }

  // Counts of each state -> where each begins.
  function offsetsOf(counts) {
    const offsets = [0];
    for (const count of counts) offsets.push(offsets[offsets.length - 1] + count);
    return offsets;
  }

  // Differences from the state before -> values, in place.
  function sumOverStates(numbers, offsets) {
    for (let k = 1; k + 1 < offsets.length; k++) {
      const before = offsets[k - 1], begin = offsets[k];
      const shared = Math.min(begin - before, offsets[k + 1] - begin);
      for (let i = 0; i < shared; i++) numbers[begin + i] = numbers[begin + i] + numbers[before + i] | 0;
    }
    return numbers;
  }

  // The run of a page. columns: name -> bytes in planes.
  function runOf(data, columns) {
    const circles = offsetsOf(data.circles), lines = offsetsOf(data.segments.map(count => 4 * count));
    const contacts = offsetsOf(data.contacts), found = {};
    for (const [name, bytes] of Object.entries(columns)) {
      found[name] = unfold(bytes);
      if (name === "lines") sumOverStates(found[name], lines);
      else if (!["a", "b", "normal", "across"].includes(name)) sumOverStates(found[name], circles);
    }
    for (let k = 0; k < data.contacts.length; k++) {
      for (let i = contacts[k] + 1; i < contacts[k + 1]; i++) found.a[i] += found.a[i - 1];
    }
    const floats = name => new Float32Array(found[name].buffer);
    const run = {...data, ...found, radius: floats("radius"), mass: floats("mass"), offsets: circles, contactOffsets: contacts, lineOffsets: lines};
    run.count = data.times.length;
    // Times that do not grow are no clock: such states follow each other at 25 a second.
    run.isTimed = data.times.every((time, k) => k === 0 || time > data.times[k - 1]);
    run.moments = data.times.map((time, k) => run.isTimed ? time - data.times[0] : k / 25);
    run.ways = waysOf(run);
    // So many decimals that each state has its own time.
    const step = run.isTimed && run.count > 1 ? (run.times[run.count - 1] - run.times[0]) / (run.count - 1) : 1;
    run.decimals = Math.min(Math.max(Math.ceil(-Math.log10(step)) + 1, 0), 12);
    return run;
  }

  const xOf = (run, i) => run.low[0] + run.unit * run.x[i];
  const yOf = (run, i) => run.low[1] + run.unit * run.y[i];
  const force = (root, top) => Math.sign(root) * (root / STEPS) ** 2 * top;
  const massPerArea = (run, i) => run.mass[i] / (Math.PI * run.radius[i] ** 2);

  // What circles can be coloured by: name -> [value of circle i in state k, least, most, unit].
  function waysOf(run) {
    const ends = of => {
      let least = Infinity, most = -Infinity;
      for (let i = 0; i < run.radius.length; i++) {
        const value = of(i);
        if (Number.isFinite(value)) { least = Math.min(least, value); most = Math.max(most, value); }
      }
      return Number.isFinite(least) ? [least, most] : [0, 0];
    };
    const speed = i => run.speed[i] * run.topSpeed / STEPS;
    const material = i => massPerArea(run, i);
    const ways = {
      speed: [speed, 0, run.topSpeed, "m/s"],
      radius: [i => run.radius[i], ...ends(i => run.radius[i]), "m"],
      material: [material, ...ends(material), "kg/m²"],
      index: [(i, k) => i - run.offsets[k], 0, Math.max(0, ...run.circles) - 1, ""],
    };
    if (run.colours) {
      const [least, most] = run.colours;
      ways["your column"] = [i => least + run.colour[i] * (most - least) / STEPS, least, most, ""];
    }
    return ways;
  }

  // The last state whose moment has come.
  function stateAt(run, moment) {
    let low = 0, high = run.count - 1;
    while (low < high) {
      const middle = low + high + 1 >> 1;
      if (run.moments[middle] <= moment + 1e-9) low = middle; else high = middle - 1;
    }
    return low;
  }

  // The end of a contact's line that lies on body b: a circle's centre, or the nearest point of a wall or segment.
  function endOf(run, k, a, b) {
    const beyond = b - run.circles[k], [xMin, yMin, xMax, yMax] = run.box;
    if (beyond < 0) return [xOf(run, run.offsets[k] + b), yOf(run, run.offsets[k] + b)];
    const x = xOf(run, run.offsets[k] + a), y = yOf(run, run.offsets[k] + a);
    if (beyond < 4) return [[x, yMin], [xMax, y], [x, yMax], [xMin, y]][beyond];
    const [x0, y0, x1, y1] = segment(run, k, beyond - 4), dx = x1 - x0, dy = y1 - y0;
    const along = Math.min(Math.max(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy || 1), 0), 1);
    return [x0 + along * dx, y0 + along * dy];
  }

  function segment(run, k, s) {
    const at = run.lineOffsets[k] + 4 * s;
    return [0, 1, 2, 3].map(i => run.low[i % 2] + run.unit * run.lines[at + i]);
  }

  // How hard contacts press on circle i of state k, N, and how many of them.
  function pressed(run, k, i) {
    let total = 0, touching = 0;
    for (let c = run.contactOffsets[k]; c < run.contactOffsets[k + 1]; c++) {
      const isOne = run.a[c] === i || run.a[c] + run.b[c] === i;
      if (isOne && run.normal[c] > 0) { total += force(run.normal[c], run.topForce); touching += 1; }
    }
    return [total, touching];
  }

  // The circle of state k at a place, m, or -1; of several that overlap the last, which is drawn above.
  function circleAt(run, k, x, y) {
    for (let i = run.offsets[k + 1] - 1; i >= run.offsets[k]; i--) {
      if (Math.hypot(x - xOf(run, i), y - yOf(run, i)) <= run.radius[i]) return i - run.offsets[k];
    }
    return -1;
  }

  function short(value) {
    if (!Number.isFinite(value)) return value > 0 ? "∞" : "–";
    const size = Math.abs(value);
    if (size !== 0 && (size >= 1e5 || size < 1e-3)) return value.toExponential(2).replace("e+", "e");
    return String(Number(value.toPrecision(4)));
  }

  function described(run, k, i) {
    if (i < 0 || i >= run.circles[k]) return "";
    const at = run.offsets[k] + i, [total, touching] = pressed(run, k, i);
    const parts = [`circle ${i}`, `(${short(xOf(run, at))}, ${short(yOf(run, at))}) m`, `r ${short(run.radius[at])} m`];
    parts.push(`${short(run.ways.speed[0](at))} m/s`);
    if (run.colours) parts.push(`value ${short(run.ways["your column"][0](at))}`);
    if (run.mass[at] === Infinity) parts.push("fixed");
    parts.push(`pressed by ${short(total)} N in ${touching} contact${touching === 1 ? "" : "s"}`);
    return parts.join(" · ");
  }

  // ---- the view: metres to pixels of the canvas ----

  // The whole box in so many pixels. ratio: pixels of the canvas for one of the page.
  function wholeView(box, width, height, ratio) {
    const [xMin, yMin, xMax, yMax] = box, margin = 24 * ratio;
    const scale = Math.max(Math.min((width - margin) / (xMax - xMin), (height - margin) / (yMax - yMin)), 1e-300);
    return {x: (xMin + xMax) / 2, y: (yMin + yMax) / 2, scale, width, height, ratio};
  }

  const toPixels = (view, x, y) => [view.width / 2 + (x - view.x) * view.scale, view.height / 2 - (y - view.y) * view.scale];
  const toMetres = (view, u, v) => [view.x + (u - view.width / 2) / view.scale, view.y - (v - view.height / 2) / view.scale];

  // Closer by a factor, so that what lies under a pixel stays there.
  function zoomed(view, factor, u, v) {
    const [x, y] = toMetres(view, u, v), scale = view.scale * factor;
    return {...view, scale, x: x - (u - view.width / 2) / scale, y: y + (v - view.height / 2) / scale};
  }

  // The largest of 1, 2, 5 · 10ᵏ up to a value.
  function roundDown(value) {
    const decade = 10 ** Math.floor(Math.log10(value));
    return [5, 2, 1].find(step => step * decade <= value) * decade;
  }

  // ---- discs and lines into pixels: a canvas without a graphics card takes five times as long for a thousand ----

  // "#d55e00" -> [213, 94, 0]
  const rgb = hex => [1, 3, 5].map(at => parseInt(hex.slice(at, at + 2), 16));
  const word = ([red, green, blue]) => (255 << 24 | blue << 16 | green << 8 | red) >>> 0;

  // One pixel, covered by a share from 0 to 1.
  function blend(pixels, at, red, green, blue, share) {
    const under = pixels[at], r = under & 255, g = under >> 8 & 255, b = under >> 16 & 255;
    pixels[at] = 255 << 24 | b + (blue - b) * share << 16 | g + (green - g) * share << 8 | r + (red - r) * share;
  }

  // A disc with an edge one pixel wide. picture: {pixels, width, height}, a word for each pixel.
  function disc({pixels, width, height}, u, v, r, colour, edge) {
    const filled = word(colour), inside = r - 1.5, far = r + 0.5;
    const red = colour[0], green = colour[1], blue = colour[2], more = [edge[0] - red, edge[1] - green, edge[2] - blue];
    const top = Math.max(0, Math.floor(v - far)), bottom = Math.min(height - 1, Math.floor(v + far));
    for (let row = top; row <= bottom; row++) {
      const dy = row + 0.5 - v, outer = far * far - dy * dy;
      if (outer <= 0) continue;
      const first = Math.max(0, Math.floor(u - Math.sqrt(outer))), last = Math.min(width - 1, Math.floor(u + Math.sqrt(outer)));
      const inner = inside > 0 ? inside * inside - dy * dy : -1;
      let from = last + 1, to = last + 1;  // of the pixels that are inside
      if (inner > 0) {
        from = Math.min(Math.max(first, Math.ceil(u - Math.sqrt(inner) - 0.5)), last + 1);
        to = Math.max(from, Math.min(last + 1, Math.floor(u + Math.sqrt(inner) + 0.5)));
        pixels.fill(filled, row * width + from, row * width + to);
      }
      for (let column = first; column <= last; column++) {
        if (column === from && to > from) { column = to - 1; continue; }
        const dx = column + 0.5 - u, distance = Math.sqrt(dx * dx + dy * dy), share = Math.min(1, far - distance);
        if (share <= 0) continue;
        const isEdge = Math.min(Math.max(distance - inside, 0), 1);
        blend(pixels, row * width + column, red + more[0] * isEdge, green + more[1] * isEdge, blue + more[2] * isEdge, share);
      }
    }
  }

  // A line with round ends, `half` wide to both sides.
  function line({pixels, width, height}, u0, v0, u1, v1, half, colour) {
    const du = u1 - u0, dv = v1 - v0, square = du * du + dv * dv || 1, far = half + 0.5;
    const red = colour[0], green = colour[1], blue = colour[2];
    const top = Math.max(0, Math.floor(Math.min(v0, v1) - far)), bottom = Math.min(height - 1, Math.floor(Math.max(v0, v1) + far));
    const wide = dv === 0 ? Infinity : far * Math.sqrt(square) / Math.abs(dv);
    const left = Math.max(0, Math.min(u0, u1) - far), right = Math.min(width - 1, Math.max(u0, u1) + far);
    for (let row = top; row <= bottom; row++) {
      const dy = row + 0.5 - v0, middle = dv === 0 ? 0 : u0 + dy * du / dv, reach = wide + Math.abs(du / (dv || 1));
      const first = Math.floor(Math.max(left, middle - reach)), last = Math.min(right, middle + reach);
      for (let column = first; column <= last; column++) {
        const dx = column + 0.5 - u0, along = Math.min(Math.max((dx * du + dy * dv) / square, 0), 1);
        const x = dx - along * du, y = dy - along * dv, away = x * x + y * y;
        if (away < far * far) blend(pixels, row * width + column, red, green, blue, Math.min(far - Math.sqrt(away), 1));
      }
    }
  }

  // ---- the picture ----

  // Paint circles and forces of state k. look: {colour, forces, back, edge, force, halo}.
  function paint(picture, run, k, view, look) {
    picture.pixels.fill(word(rgb(look.back)));
    const [value, least, most] = run.ways[look.colour], span = most - least || 1, edge = rgb(look.edge);
    for (let i = run.offsets[k]; i < run.offsets[k + 1]; i++) {
      const [u, v] = toPixels(view, xOf(run, i), yOf(run, i)), r = Math.max(run.radius[i] * view.scale, 0.5);
      if (u + r < 0 || u - r > view.width || v + r < 0 || v - r > view.height) continue;
      const share = (value(i, k) - least) / span, isFixed = !Number.isFinite(share);
      const colour = isFixed ? FIXED : shades[Math.round(Math.min(Math.max(share, 0), 1) * (SHADES - 1))];
      const shown = Math.min(Math.max(r / 4 - 0.5, 0), 1);  // small circles have no edge
      disc(picture, u, v, r, colour, edge.map((part, j) => colour[j] + shown * (part - colour[j])));
      if (r < 4) continue;
      const dx = r * Math.cos(run.angle[i] * TURN), dy = -r * Math.sin(run.angle[i] * TURN);
      line(picture, u + 0.5 * dx, v + 0.5 * dy, u + 0.9 * dx, v + 0.9 * dy, 0.6 * view.ratio, isLight(colour) ? DARK : LIGHT);
    }
    if (look.forces) paintForces(picture, run, k, view, look);
  }

  function paintForces(picture, run, k, view, look) {
    for (const [colour, more] of [[rgb(look.halo), 0.8], [rgb(look.force), 0]]) {
      for (let c = run.contactOffsets[k]; c < run.contactOffsets[k + 1]; c++) {
        const share = Math.min(force(run.normal[c], run.topForce) / run.widest, 1);
        if (!(share > 0.004)) continue;
        const a = run.a[c], i = run.offsets[k] + a, end = endOf(run, k, a, a + run.b[c]);
        const half = (0.2 + WIDEST / 2 * share + more) * view.ratio;
        line(picture, ...toPixels(view, xOf(run, i), yOf(run, i)), ...toPixels(view, ...end), half, colour);
      }
    }
  }

  // Walls, segments, the circle that was picked and the scale, above the pixels. look: {text, mark, halo, picked}.
  function draw(context, run, k, view, look) {
    const [left, top] = toPixels(view, run.box[0], run.box[3]), [right, bottom] = toPixels(view, run.box[2], run.box[1]);
    context.strokeStyle = context.fillStyle = look.text;
    context.lineWidth = 2 * view.ratio;
    context.strokeRect(left, top, right - left, bottom - top);
    context.beginPath();
    for (let s = 0; s < run.segments[k]; s++) {
      const [x0, y0, x1, y1] = segment(run, k, s);
      context.moveTo(...toPixels(view, x0, y0));
      context.lineTo(...toPixels(view, x1, y1));
      const drags = Math.sign(run.surfaces[s] || 0);
      if (drags) drawArrowhead(context, view, drags, x0, y0, x1, y1);
    }
    context.stroke();
    const picked = run.offsets[k] + look.picked;
    if (look.picked >= 0 && look.picked < run.circles[k]) {
      context.strokeStyle = look.mark;
      context.beginPath();
      const [u, v] = toPixels(view, xOf(run, picked), yOf(run, picked));
      context.arc(u, v, Math.max(run.radius[picked] * view.scale, 2) + 2 * view.ratio, 0, 2 * Math.PI);
      context.stroke();
    }
    drawScale(context, view, look);
  }

  // At the middle of a belt, the way in which it drags.
  function drawArrowhead(context, view, drags, x0, y0, x1, y1) {
    const [u, v] = toPixels(view, (x0 + x1) / 2, (y0 + y1) / 2), long = Math.hypot(x1 - x0, y1 - y0) / (8 * view.ratio * drags);
    const du = (x1 - x0) / long, dv = (y0 - y1) / long;
    context.moveTo(u - du - dv / 2, v - dv + du / 2);
    context.lineTo(u, v);
    context.lineTo(u - du + dv / 2, v - dv - du / 2);
  }

  function drawScale(context, view, look) {
    const one = view.ratio, metres = roundDown(Math.min(140 * one, view.width / 3) / view.scale), long = metres * view.scale;
    const text = `${short(metres)} m`, y = view.height - 12 * one, x = 14 * one;
    context.font = `${13 * one}px system-ui, sans-serif`;
    context.fillStyle = look.halo;
    context.globalAlpha = 0.8;
    context.fillRect(x - 6 * one, y - 9 * one, long + context.measureText(text).width + 22 * one, 18 * one);
    context.globalAlpha = 1;
    context.strokeStyle = context.fillStyle = look.text;
    context.lineWidth = 1.5 * one;
    context.beginPath();
    for (const end of [x, x + long]) { context.moveTo(end, y - 5 * one); context.lineTo(end, y + 5 * one); }
    context.moveTo(x, y);
    context.lineTo(x + long, y);
    context.stroke();
    context.textBaseline = "middle";
    context.fillText(text, x + long + 6 * one, y);
  }

  // ---- the document ----

  async function unpacked(text) {
    const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  async function start(document) {
    const part = name => document.getElementById(name), window = document.defaultView;
    const data = JSON.parse(part("data").textContent), columns = {};
    document.title = data.name;
    part("name").textContent = part("name").title = data.name;
    for (const [name, text] of Object.entries(data.columns)) columns[name] = await unpacked(text);
    const run = runOf(data, columns), canvas = part("scene"), context = canvas.getContext("2d", {willReadFrequently: true});
    const look = {colour: run.colours ? "your column" : "speed", forces: false, picked: -1};
    let view = null, image = null, picture = null, isWhole = true, k = 0, moment = 0, isPlaying = false, before = 0, hovered = -1, isDue = false;

    for (const [list, names] of [[part("pace"), PACES], [part("colour"), Object.keys(run.ways)]]) {
      for (const name of names) list.add(new window.Option(list === part("pace") ? `${name} ×` : name, name));
    }
    part("pace").value = "1";
    part("colour").value = look.colour;
    part("slider").max = run.count - 1;
    part("circle").max = Math.max(0, ...run.circles) - 1;
    part("ramp").style.background = `linear-gradient(to right, ${shades.map(colour => `rgb(${colour})`)})`;
    part("forces").disabled = !run.widest;
    part("widest").textContent = run.widest ? `widest: ${short(run.widest)} N` : "none";
    part("forces").parentElement.title = run.isMean ? "The mean of each step (f)" : "Of the last substep before each state (f)";

    function takeColours() {
      const style = window.getComputedStyle(document.documentElement);
      for (const name of ["back", "edge", "text", "force", "halo", "mark"]) look[name] = style.getPropertyValue(`--${name}`).trim();
    }

    function fit() {
      const ratio = window.devicePixelRatio || 1;
      const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
      if (!width || !height) return;
      [canvas.width, canvas.height] = [width, height];
      image = context.createImageData(width, height);
      picture = {pixels: new Uint32Array(image.data.buffer), width, height};
      view = isWhole || !view ? wholeView(run.box, width, height, ratio) : {...view, width, height, ratio};
      redraw();
    }

    // Draw with the next picture of the screen, once.
    function redraw() {
      if (!isDue) { isDue = true; window.requestAnimationFrame(now => { isDue = false; shown(now); }); }
    }

    function shown(now) {
      if (isPlaying) {
        moment += before ? (now - before) / 1000 * Number(part("pace").value) : 0;
        before = now;
        k = stateAt(run, moment);
        if (k === run.count - 1) play(false);
      }
      if (view) {
        paint(picture, run, k, view, look);
        context.putImageData(image, 0, 0);
        draw(context, run, k, view, look);
      }
      part("slider").value = k;
      part("clock").textContent = `t = ${run.times[k].toFixed(run.decimals)} s · ${k + 1} / ${run.count}`;
      part("under").textContent = described(run, k, hovered >= 0 ? hovered : look.picked) || "point at a circle, or write its number";
      if (isPlaying) redraw();
    }

    function play(on) {
      if (on && k === run.count - 1) k = 0;
      isPlaying = on && run.count > 1;
      before = 0;
      moment = run.moments[k];
      part("play").textContent = isPlaying ? "❚❚" : "▶";
      part("play").setAttribute("aria-label", isPlaying ? "Pause" : "Play");
      redraw();
    }

    function show(state) {
      k = Math.min(Math.max(state, 0), run.count - 1);
      play(false);
    }

    function colourBy(name) {
      look.colour = part("colour").value = name;
      const [, least, most, unit] = run.ways[name];
      part("low").textContent = short(least);
      part("high").textContent = `${short(most)} ${unit}`;
      redraw();
    }

    function zoom(factor, u = view.width / 2, v = view.height / 2) {
      view = zoomed(view, factor, u, v);
      isWhole = false;
      redraw();
    }

    function move(du, dv) {
      view = {...view, x: view.x - du / view.scale, y: view.y + dv / view.scale};
      isWhole = false;
      redraw();
    }

    const fromList = (name, step) => {
      const list = part(name);
      list.selectedIndex = Math.min(Math.max(list.selectedIndex + step, 0), list.options.length - 1);
    };
    const toggleForces = () => { look.forces = part("forces").checked; redraw(); };
    const keys = {
      " ": () => play(!isPlaying),
      ArrowLeft: () => show(k - 1), ArrowRight: () => show(k + 1), Home: () => show(0), End: () => show(run.count - 1),
      "+": () => zoom(1.25), "=": () => zoom(1.25), "-": () => zoom(0.8), "0": () => { isWhole = true; fit(); },
      "[": () => fromList("pace", -1), "]": () => fromList("pace", 1),
      c: () => { const names = Object.keys(run.ways); colourBy(names[(names.indexOf(look.colour) + 1) % names.length]); },
      f: () => { if (!part("forces").disabled) { part("forces").checked = !part("forces").checked; toggleForces(); } },
    };
    const moves = {ArrowLeft: [80, 0], ArrowRight: [-80, 0], ArrowUp: [0, 80], ArrowDown: [0, -80]};
    document.addEventListener("keydown", event => {
      const at = event.target, kind = at.type;
      // What has the focus keeps the keys that it needs itself.
      const isTyped = kind === "number" || kind === "select-one", isPressed = event.key === " " && (kind === "submit" || kind === "checkbox");
      if (event.ctrlKey || event.metaKey || event.altKey || isTyped || isPressed) return;
      const done = event.shiftKey && moves[event.key] ? () => move(...moves[event.key]) : keys[event.key];
      if (done) { event.preventDefault(); done(); }
    });
    part("play").onclick = keys[" "];
    part("back").onclick = keys.ArrowLeft;
    part("next").onclick = keys.ArrowRight;
    part("closer").onclick = keys["+"];
    part("farther").onclick = keys["-"];
    part("whole").onclick = keys["0"];
    part("slider").oninput = () => show(Number(part("slider").value));
    part("colour").onchange = () => colourBy(part("colour").value);
    part("forces").onchange = toggleForces;
    part("circle").oninput = () => {
      const number = part("circle").valueAsNumber;
      look.picked = Number.isInteger(number) ? number : -1;
      redraw();
    };

    // One pointer drags, two zoom; a click picks a circle.
    const placeOf = event => [event.offsetX * view.ratio, event.offsetY * view.ratio];
    const pointers = new Map();
    let dragged = 0;
    canvas.onpointerdown = event => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, placeOf(event));
      dragged = 0;
    };
    canvas.onpointermove = event => {
      const here = placeOf(event), last = pointers.get(event.pointerId);
      if (last) {
        const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
        dragged += Math.hypot(here[0] - last[0], here[1] - last[1]);
        if (others.length) {
          const away = place => Math.hypot(place[0] - others[0][0], place[1] - others[0][1]) || 1;
          zoom(away(here) / away(last), ...others[0]);
        } else if (dragged > 3) move(here[0] - last[0], here[1] - last[1]);
        pointers.set(event.pointerId, here);
      }
      hovered = circleAt(run, k, ...toMetres(view, ...here));
      redraw();
    };
    canvas.onpointerup = canvas.onpointercancel = event => {
      pointers.delete(event.pointerId);
      if (dragged > 3 || event.type === "pointercancel") return;
      look.picked = circleAt(run, k, ...toMetres(view, ...placeOf(event)));
      part("circle").value = look.picked >= 0 ? look.picked : "";
      redraw();
    };
    canvas.onpointerleave = () => { hovered = -1; redraw(); };
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      zoom(Math.exp(-0.0015 * event.deltaY), ...placeOf(event));
    }, {passive: false});

    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { takeColours(); redraw(); });
    new window.ResizeObserver(fit).observe(canvas);
    takeColours();
    colourBy(look.colour);
    fit();
  }

  return {start, runOf, paint, draw, stateAt, circleAt, described, endOf, wholeView, zoomed, toPixels, toMetres, roundDown, colourAt, short, xOf, yOf};
})();
