// The viewer: images and overlays of one pair, laid over each other, and the disparity under the cursor.
(() => {
  const find = (id) => document.getElementById(id);
  const pairs = JSON.parse(find("data").textContent);
  const stage = find("stage"), layers = [...stage.querySelectorAll("img")];
  const chosen = (name) => document.querySelector(`[name=${name}]:checked`).value;
  let number = 0, values = null, timer = 0, flipped = false;

  function draw() {
    const image = chosen("image"), other = image === "left" ? "right" : "left", seen = flipped ? other : image;
    for (const layer of layers) {
      // Overlays belong to pixels of the left view, which the warped image has too.
      const shown = layer.dataset.image ? layer.dataset.image === seen : layer.dataset.overlay === chosen("overlay") && seen !== "right";
      layer.style.visibility = shown ? "visible" : "hidden";
    }
    stage.dataset.image = seen;
    find("legend").hidden = chosen("overlay") !== "masks";
  }

  async function show(wanted) {
    const mine = (number = (wanted + pairs.length) % pairs.length), pair = pairs[mine];
    find("viewer").hidden = false;
    values = null;
    const colours = pair.colours.map((px) => px.toFixed(1)).join(" to ");
    find("caption").textContent = `${pair.name}${pair.recipe ? `, recipe ${pair.recipe}` : ""}; colours from ${colours} px`;
    stage.style.width = `min(100%, ${(80 * pair.width) / pair.height}vh)`;
    for (const [k, button] of [...find("strip").children].entries()) button.setAttribute("aria-pressed", String(k === mine));
    for (const layer of layers) layer.src = pair[layer.dataset.image ?? layer.dataset.overlay];
    draw();
    const bytes = Uint8Array.from(atob(pair.values), (character) => character.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const floats = new Float32Array(await new Response(stream).arrayBuffer());
    if (mine !== number) return;
    values = floats;
    stage.dataset.pair = String(mine);
  }

  function read(event) {
    if (values === null) return;
    const pair = pairs[number], box = stage.getBoundingClientRect();
    const at = (part, size) => Math.max(0, Math.min(size - 1, Math.floor(part * size)));
    const column = at((event.clientX - box.left) / box.width, pair.width);
    const row = at((event.clientY - box.top) / box.height, pair.height);
    const disparity = values[row * pair.width + column], depth = pair.focal_baseline / (disparity + pair.doffs);
    const x = column * pair.step + (pair.step >> 1), y = row * pair.step + (pair.step >> 1);
    const truth = [`disparity ${Number(disparity.toPrecision(9))} px`, `right view at x ${(x - disparity).toFixed(2)}`,
      depth > 0 && depth < 1e9 ? `depth ${depth.toPrecision(4)} m` : "infinitely far away"];
    find("readout").textContent = [`x ${x}, y ${y}`, ...(Number.isFinite(disparity) ? truth : ["no disparity"])].join(" · ");
  }

  function flicker() {
    timer = timer === 0 ? setInterval(() => { flipped = !flipped; draw(); }, 500) : clearInterval(timer) ?? 0;
    flipped = false;
    find("flicker").setAttribute("aria-pressed", String(timer !== 0));
    draw();
  }

  const keys = { f: flicker, n: () => show(number + 1), p: () => show(number - 1) };
  for (const [k, pair] of pairs.entries()) {
    const button = Object.assign(document.createElement("button"), { type: "button", onclick: () => show(k) });
    button.append(Object.assign(new Image(), { alt: "", src: pair.left }), pair.name);
    find("strip").append(button);
  }
  for (const input of document.querySelectorAll("#viewer input")) input.addEventListener("change", draw);
  for (const link of document.querySelectorAll("a[data-pair]")) link.addEventListener("click", () => show(Number(link.dataset.pair)));
  find("flicker").addEventListener("click", flicker);
  stage.addEventListener("pointermove", read);
  if (pairs.length === 0) return;
  document.addEventListener("keydown", (event) => event.ctrlKey || event.metaKey || event.altKey || event.repeat || keys[event.key.toLowerCase()]?.());
  show(0);
})();
