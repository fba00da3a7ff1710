// Curves (report/interactive.py): their values at the pointer's place in the panel under it, and
// buttons that switch them off and on. The picture stays an image; switching draws it anew.
for (const source of document.querySelectorAll("script.curves")) {
  const place = document.getElementById(source.dataset.figure);
  const image = place && (place.matches("img") ? place : place.querySelector("img"));
  if (image) interactive(image, JSON.parse(source.textContent));
}

function interactive(image, { panels, switches: named }) {
  const off = new Set();
  const shown = (artist) => !artist.switches.some((name) => off.has(name));

  // Values: a line where the pointer is, and a box outside of the panel, which covers no curve.
  const frame = document.createElement("span");
  frame.className = "plot";
  image.replaceWith(frame);
  const marker = document.createElement("span");
  marker.className = "marker";
  marker.hidden = true;
  frame.append(image, marker);
  const leave = () => { marker.hidden = true; hideTip(); };
  image.addEventListener("pointermove", (event) => {
    const box = inner(image);
    const x = (event.clientX - box.left) / box.width;
    const y = (event.clientY - box.top) / box.height;
    const panel = panels.find((one) => x >= one.left && x <= one.left + one.width
      && y >= one.top && y <= one.top + one.height);
    const at = panel && panel.x_min + (x - panel.left) / panel.width * (panel.x_max - panel.x_min);
    const found = panel ? values(panel, panel.artists.filter(shown), at) : [];
    if (!found.length) { leave(); return; }
    const outer = frame.getBoundingClientRect();
    const top = box.top + panel.top * box.height;
    const bottom = top + panel.height * box.height;
    Object.assign(marker.style, {
      left: `${event.clientX - outer.left}px`, top: `${top - outer.top}px`, height: `${bottom - top}px`,
    });
    marker.hidden = false;
    showTip([element("p", `${panel.x_label}: ${rounded(at, panel)}`),
      ...found.map(([name, value]) => element("p", `${name}: ${value.toFixed(1)}`))], event.clientX, top);
    const tall = tip.getBoundingClientRect().height;
    const above = panel.top + panel.height / 2 < 0.5 && top - tall - 6 > 0;
    tip.style.top = `${(above ? top - tall - 6 : bottom + 6) + window.scrollY}px`;
  });
  image.addEventListener("pointerleave", leave);

  // Switches: what one of them has switched off is not in the picture, nor among the values.
  if (named.length < 2) return;
  const data = image.src.slice(image.src.indexOf(",") + 1);
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const drawing = new DOMParser().parseFromString(new TextDecoder().decode(bytes), "image/svg+xml");
  const redraw = () => {
    for (const artist of panels.flatMap((panel) => panel.artists)) {
      drawing.getElementById(artist.id).style.display = shown(artist) ? "" : "none";
    }
    const text = new XMLSerializer().serializeToString(drawing);
    image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
  };
  const group = switches("Curves shown", "Click to hide:", named.map(({ name }) => [name, true, (on) => {
    if (on) off.delete(name); else off.add(name);
    redraw();
  }]));
  [...group.querySelectorAll("button")].forEach((button, number) => {
    const { colour, marks } = named[number];
    if (marks) button.dataset.marks = marks;
    button.style.setProperty("--line-colour", colour);
  });
  frame.after(group);
}

// Where the picture itself lies, without the image's padding.
function inner(image) {
  const box = image.getBoundingClientRect();
  const pad = parseFloat(getComputedStyle(image).paddingLeft);
  return { left: box.left + pad, top: box.top + pad, width: box.width - 2 * pad, height: box.height - 2 * pad };
}

// [name, value] of each curve that reaches x, and of each row of points that has one close to it.
function values(panel, artists, x) {
  const close = (panel.x_max - panel.x_min) / 50;
  return artists.filter((artist) => artist.name).flatMap(({ name, points, xs, ys }) => {
    let nearest = 0;
    for (let i = 1; i < xs.length; i += 1) {
      if (Math.abs(xs[i] - x) < Math.abs(xs[nearest] - x)) nearest = i;
    }
    const reached = points ? Math.abs(xs[nearest] - x) < close : x >= xs[0] && x <= xs[xs.length - 1];
    return reached ? [[name, ys[nearest]]] : [];
  });
}

// As many digits as a hundredth of the axis needs.
function rounded(x, panel) {
  const digits = Math.max(0, Math.ceil(-Math.log10((panel.x_max - panel.x_min) / 100)));
  return x.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });
}
