"use strict";
// The page of a live run: it shows the newest frame from the server.
(() => {
  const { data, draw, render } = page;
  const { surface, moved, solid, pad, space } = solids;
  const body = surface(data.mesh);
  let now = { T: null, contact: data.pad.contact, camera: data.camera };

  draw("scene", (c) => {
    const at = now.T ? moved(body.at, now.T) : body.at;
    const shown = { name: "object", visible: Boolean(now.T), opacity: now.touches ? 1 : 0.4 };
    const object = solid(at, body.faces, c.steel, shown);
    const traces = [object, ...pad(c, { ...data.pad, contact: now.contact })];
    return { data: traces, layout: space("scene", data.bounds, now.camera) };
  });

  // Two outlines are drawn: the observed outline, and the outline that the pose predicts.
  function madeIn(figure) {
    const seen = figure.querySelector(".outline"), made = seen.cloneNode();
    made.classList.add("made");
    seen.after(made);
    return { image: figure.querySelector("image"), seen, made };
  }

  const places = ["photo", "shape"].map((id) => madeIn(document.getElementById(id)));

  function show(state) {
    now = { ...state, camera: now.T ? now.camera : state.camera || now.camera }; // the camera stays while there is a pose
    for (const [name, text] of Object.entries(state.texts)) document.getElementById(name).textContent = text;
    document.documentElement.dataset.number = state.number;
    places.forEach((place, k) => {
      place.image.setAttribute("href", state.pictures[k] || "data:,");
      place.seen.setAttribute("d", state.outline);
      place.made.setAttribute("d", state.made);
    });
    document.getElementById("photo").hidden = !state.pictures[0];
    render("scene");
  }

  const ended = (text) => { document.getElementById("verdict").textContent = text; };
  const events = new EventSource("events");
  events.onmessage = (event) => show(JSON.parse(event.data));
  events.addEventListener("end", () => { events.close(); ended("ended"); });
  events.onerror = () => ended("not connected");
})();
