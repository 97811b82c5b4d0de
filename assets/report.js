"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const find = (id) => document.getElementById(id);
  const stage = find("stage"), base = find("base"), overlay = find("overlay"), cursor = find("cursor");
  const VISIBLE = 255, OCCLUDED = 128;
  const MASK_MEANINGS = { 255: "visible in the right view", 128: "hidden in the right view", 0: "outside the right view" };
  const IMAGE_NAMES = { left: "left", right: "right", warped: "right, warped to the left" };
  const state = { pair: 0, image: "left", other: "right", overlay: "none", flipped: false, held: false, timer: 0, at: null };
  // The decoded pair; null while it is not ready.
  let shown = null;
  let requests = 0;

  function bytesOf(id) {
    const element = find(id);
    return element === null ? null : Uint8Array.from(atob(element.textContent), (character) => character.charCodeAt(0));
  }

  async function inflated(id) {
    const bytes = bytesOf(id);
    if (bytes === null) return null;
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  // The counterpart of pack_floats: four planes of bytes, lowest first, of differences along each row.
  function unpackFloats(planes, width, height) {
    const count = width * height;
    const bits = new Uint32Array(count);
    for (let row = 0; row < height; row++) {
      let last = 0;
      for (let k = row * width; k < (row + 1) * width; k++) {
        last += planes[k] | (planes[k + count] << 8) | (planes[k + 2 * count] << 16) | (planes[k + 3 * count] << 24);
        bits[k] = last;
        last = bits[k];
      }
    }
    return new Float32Array(bits.buffer);
  }

  async function floatsOf(id, pair) {
    const planes = await inflated(id), wanted = 4 * pair.width * pair.height;
    if (planes.length !== wanted) throw new Error("expected " + wanted + " bytes of disparity, got " + planes.length);
    return unpackFloats(planes, pair.width, pair.height);
  }

  async function imageOf(id) {
    const image = new Image();
    image.src = "data:image/jpeg;base64," + find(id).textContent;
    await image.decode();
    return image;
  }

  async function show(number) {
    if (data.pairs.length === 0) return;
    state.pair = (number + data.pairs.length) % data.pairs.length;
    const request = ++requests, pair = data.pairs[state.pair], id = "pair-" + state.pair;
    for (const [k, button] of [...find("strip").children].entries()) {
      button.setAttribute("aria-pressed", String(k === state.pair));
      if (k === state.pair) {
        const strip = find("strip");
        strip.scrollLeft = button.offsetLeft - strip.offsetLeft - strip.clientWidth / 2 + button.clientWidth / 2;
      }
    }
    find("caption").textContent = pair.caption;
    if (shown === null) {
      // The text below keeps its place when the first pair is ready.
      for (const canvas of [base, overlay]) [canvas.width, canvas.height] = [pair.width, pair.height];
      resize();
    }
    let decoded;
    try {
      decoded = await Promise.all([
        imageOf(id + "-left"), imageOf(id + "-right"), floatsOf(id + "-disparity", pair), inflated(id + "-visibility"),
      ]);
    } catch (error) {
      if (request === requests) fail(pair, error);
      return;
    }
    if (request !== requests) return;
    const [left, right, disparity, visibility] = decoded;
    shown = { pair, left, right, visibility, disparity, warped: null };
    for (const canvas of [base, overlay]) [canvas.width, canvas.height] = [pair.width, pair.height];
    for (const input of document.querySelectorAll("[name=overlay][value=occlusion]")) input.disabled = visibility === null;
    if (state.overlay === "occlusion" && visibility === null) choose("overlay", "none");
    resize();
    drawOverlay();
    draw();
    read();
    stage.dataset.pair = String(state.pair);
  }

  // The picture of the previous pair must not stand under this pair's caption.
  function fail(pair, error) {
    shown = null;
    for (const canvas of [base, overlay]) canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
    find("caption").textContent =
      pair.caption + " \u2013 cannot be shown: " + error.message + ". A browser from 2023 or later shows all pairs of a " +
      "complete page.";
    find("showing").textContent = find("readout").textContent = "";
    find("legend").replaceChildren();
    find("scale").hidden = cursor.hidden = true;
    delete stage.dataset.pair;
  }

  // The colour of the right image at x - d for each pixel x of the left view; grey where the right eye does not see it.
  function warped() {
    if (shown.warped !== null) return shown.warped;
    const { pair, disparity, visibility } = shown, { width, height } = pair;
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(shown.right, 0, 0);
    const from = context.getImageData(0, 0, width, height).data, to = context.createImageData(width, height);
    for (let row = 0, k = 0; row < height; row++) {
      for (let column = 0; column < width; column++, k++) {
        const x = column - disparity[k] / pair.step;
        const seen = x >= 0 && x <= width - 1 && (visibility === null || visibility[k] === VISIBLE);
        const first = Math.min(Math.floor(x), width - 2), part = x - first;
        for (let channel = 0; channel < 3; channel++) {
          const source = 4 * (row * width + first) + channel;
          to.data[4 * k + channel] = seen ? (1 - part) * from[source] + part * from[source + 4] : 119;
        }
        to.data[4 * k + 3] = 255;
      }
    }
    context.putImageData(to, 0, 0);
    return (shown.warped = canvas);
  }

  function visibleImage() {
    return state.flipped !== state.held ? state.other : state.image;
  }

  function draw() {
    if (shown === null) return;
    const name = visibleImage();
    base.getContext("2d").drawImage(name === "warped" ? warped() : shown[name], 0, 0);
    // The overlays belong to pixels of the left view; the warped image has those too.
    overlay.style.visibility = name === "right" ? "hidden" : "visible";
    find("showing").textContent = "Showing: " + IMAGE_NAMES[name] + ".";
    stage.dataset.image = name;
  }

  function colourAt(part) {
    return data.colours[Math.max(0, Math.min(data.colours.length - 1, Math.round(part * (data.colours.length - 1))))];
  }

  function drawOverlay() {
    if (shown === null) return;
    const { pair, disparity, visibility } = shown, context = overlay.getContext("2d");
    const picture = context.createImageData(pair.width, pair.height);
    const span = pair.high - pair.low || 1;
    const alpha = Math.round(255 * Number(find("opacity").value));
    for (let k = 0; k < disparity.length; k++) {
      const valid = Number.isFinite(disparity[k]);
      let colour = null;
      if (state.overlay === "disparity") colour = valid ? colourAt((disparity[k] - pair.low) / span) : data.none;
      else if (state.overlay === "invalid") colour = valid ? null : data.none;
      else if (state.overlay === "occlusion" && visibility[k] !== VISIBLE) {
        colour = visibility[k] === OCCLUDED ? data.occluded : data.outside;
      }
      if (colour !== null) picture.data.set([...colour, alpha], 4 * k);
    }
    context.putImageData(picture, 0, 0);
    drawLegend();
  }

  function drawLegend() {
    const { pair } = shown, legend = find("legend");
    find("scale").hidden = state.overlay !== "disparity" || pair.low === null;
    if (!find("scale").hidden) {
      find("scale-low").textContent = "\u2264 " + pair.low.toFixed(1) + " px";
      find("scale-high").textContent = "\u2265 " + pair.high.toFixed(1) + " px";
      const ramp = find("ramp").getContext("2d"), row = ramp.createImageData(256, 1);
      for (let k = 0; k < 256; k++) row.data.set([...colourAt(k / 255), 255], 4 * k);
      ramp.putImageData(row, 0, 0);
    }
    const entries = {
      disparity: [[data.none, "no disparity"]],
      occlusion: [[data.occluded, "hidden in the right view"], [data.outside, "outside the right view"]],
      invalid: [[data.none, "no disparity"]],
      none: [],
    }[state.overlay];
    legend.replaceChildren(...entries.flatMap(([colour, name]) => {
      const swatch = Object.assign(document.createElement("span"), { className: "swatch" });
      swatch.style.background = "rgb(" + colour.join(" ") + ")";
      return [swatch, name];
    }));
  }

  // The shortest decimal that stands for this float32 alone.
  function shortest(value) {
    for (let digits = 1; digits < 9; digits++) {
      const text = value.toPrecision(digits);
      if (Math.fround(Number(text)) === value) return String(Number(text));
    }
    return String(Number(value.toPrecision(9)));
  }

  function read() {
    cursor.hidden = state.at === null || shown === null;
    if (state.at === null || shown === null) return;
    const { pair, disparity, visibility } = shown;
    state.at = [Math.max(0, Math.min(pair.width - 1, state.at[0])), Math.max(0, Math.min(pair.height - 1, state.at[1]))];
    const [column, row] = state.at, k = row * pair.width + column, d = disparity[k];
    const x = column * pair.step + Math.floor(pair.step / 2), y = row * pair.step + Math.floor(pair.step / 2);
    cursor.style.left = (100 * (column + 0.5)) / pair.width + "%";
    cursor.style.top = (100 * (row + 0.5)) / pair.height + "%";
    const parts = ["left view, x " + x + ", y " + y];
    if (Number.isFinite(d)) {
      parts.push("disparity " + shortest(d) + " px", "right view at x " + (x - d).toFixed(2));
      // As far as float32 tells.
      const parallax = d + pair.doffs, far = parallax <= 1e-6 * Math.abs(pair.doffs);
      parts.push(far ? "infinitely far away" : (pair.rectified ? "depth " : "depth about ") + (pair.focal_baseline / parallax).toPrecision(4) + " m");
    } else parts.push("no disparity");
    if (visibility !== null) parts.push(MASK_MEANINGS[visibility[k]] ?? "mask " + visibility[k]);
    find("readout").textContent = parts.join(" · ");
  }

  function resize() {
    const zoom = Number(find("zoom").value), pair = data.pairs[state.pair];
    stage.classList.toggle("zoomed", zoom > 0);
    const fitting = "min(100%, calc(80vh * " + pair.width / pair.height + "))";
    stage.style.width = zoom > 0 ? pair.width * zoom + "px" : fitting;
  }

  function choose(name, value) {
    state[name] = value;
    for (const input of document.getElementsByName(name)) input.checked = input.value === value;
  }

  function flicker() {
    const running = state.timer === 0;
    clearInterval(state.timer);
    state.timer = 0;
    state.flipped = false;
    if (running) {
      state.timer = setInterval(() => {
        state.flipped = !state.flipped;
        draw();
      }, 1000 / Number(find("rate").value));
    }
    find("flicker").setAttribute("aria-pressed", String(running));
    draw();
  }

  function hold(held) {
    if (state.held === held) return;
    state.held = held;
    find("hold").classList.toggle("held", held);
    draw();
  }

  for (const [number, pair] of data.pairs.entries()) {
    const button = Object.assign(document.createElement("button"), { type: "button", title: pair.caption });
    const picture = Object.assign(document.createElement("img"), { alt: "" });
    picture.src = "data:image/jpeg;base64," + find("pair-" + number + "-thumbnail").textContent;
    button.append(picture, pair.label);
    button.addEventListener("click", () => show(number));
    find("strip").append(button);
  }
  for (const input of document.querySelectorAll("[name=image]")) {
    input.addEventListener("change", () => {
      state.image = input.value;
      // An image is never compared with itself.
      if (state.other === state.image) find("other").value = state.other = state.image === "left" ? "right" : "left";
      draw();
    });
  }
  for (const input of document.querySelectorAll("[name=overlay]")) {
    input.addEventListener("change", () => {
      state.overlay = input.value;
      drawOverlay();
    });
  }
  find("other").addEventListener("change", (event) => {
    state.other = event.target.value;
    if (state.other === state.image) choose("image", state.other === "left" ? "right" : "left");
    draw();
  });
  find("opacity").addEventListener("input", drawOverlay);
  find("zoom").addEventListener("change", resize);
  find("flicker").addEventListener("click", flicker);
  find("rate").addEventListener("input", (event) => {
    find("rate-value").textContent = event.target.value + " Hz";
    if (state.timer !== 0) {
      flicker();
      flicker();
    }
  });
  find("hold").addEventListener("pointerdown", () => hold(true));
  for (const name of ["pointerup", "pointerleave", "pointercancel", "blur", "keyup"]) {
    find("hold").addEventListener(name, () => hold(false));
  }
  find("hold").addEventListener("keydown", (event) => {
    if (event.key === " " || event.key === "Enter") hold(true);
  });
  stage.addEventListener("pointermove", (event) => {
    if (shown === null) return;
    const box = base.getBoundingClientRect();
    state.at = [
      Math.floor(((event.clientX - box.left) / box.width) * shown.pair.width),
      Math.floor(((event.clientY - box.top) / box.height) * shown.pair.height),
    ];
    read();
  });
  stage.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 10 : 1;
    const move = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[event.key];
    if (move === undefined || shown === null) return;
    event.preventDefault();
    const [x, y] = state.at ?? [shown.pair.width >> 1, shown.pair.height >> 1];
    state.at = [x + move[0], y + move[1]];
    read();
  });
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest("select, input:not([type=radio]):not([type=range])");
    if (typing !== null || event.ctrlKey || event.altKey || event.metaKey) return;
    const key = event.key.toLowerCase();
    if (key === "c") hold(true);
    else if (event.repeat) return;
    else if (key === "f") flicker();
    else if (key === "n" || key === "p") show(state.pair + (key === "n" ? 1 : -1));
    else if (key === "o") {
      const names = ["none", "disparity", ...(shown?.visibility ? ["occlusion"] : []), "invalid"];
      choose("overlay", names[(names.indexOf(state.overlay) + 1) % names.length]);
      drawOverlay();
    }
  });
  document.addEventListener("keyup", (event) => {
    if (event.key.toLowerCase() === "c") hold(false);
  });
  window.addEventListener("blur", () => hold(false));
  for (const link of document.querySelectorAll("a[data-pair]")) {
    link.addEventListener("click", () => show(Number(link.dataset.pair)));
  }
  if (data.pairs.length > 0) {
    find("viewer").hidden = false;
    show(0);
  }
})();
