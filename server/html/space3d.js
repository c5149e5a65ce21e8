/* Draws what a robot tells of space in three dimensions: clouds, scans, maps, paths, poses, frames, and its model.

It takes every element that has data-space3d, the address of a view, whose event stream tells what is drawn and where
that is. The points of a cloud are a file of their own (PLY), asked for whenever the one before is drawn. Without this
file and space_view.js, or without WebGL, the page tells the same in words. */
import {
  AmbientLight, AxesHelper, Box3, BufferGeometry, CanvasTexture, Color, DirectionalLight, DoubleSide,
  Float32BufferAttribute, GridHelper, Group, Line,
  LineBasicMaterial, LineLoop, LineSegments, Mesh, MeshBasicMaterial, NearestFilter, OrbitControls, PerspectiveCamera,
  PlaneGeometry, Points, PointsMaterial, Quaternion, Scene, Sphere, Sprite, SpriteMaterial, SRGBColorSpace, TextureLoader, URDFLoader,
  Vector3, WebGLRenderer,
} from "./three.js?v=0.187.0-urdf";

const TRACE = 5000, STEP = 0.02; // points of a trace, and metres between two of them
const COUNTS = [5000, 20000, 100000, 200000]; // points of a cloud to choose from
const RAMP = ["#3b2f8f", "#2f6fa8", "#1f968b", "#55b257", "#c9b21e"].map((each) => new Color(each));
const LINEAR = Float32Array.from({ length: 256 }, (_, each) => new Color(each / 255, 0, 0).convertSRGBToLinear().r);

const { element, button } = SpaceView;
const isDark = matchMedia("(prefers-color-scheme: dark)");
const geometry = (positions) => new BufferGeometry().setAttribute("position", new Float32BufferAttribute(positions, 3));

/* A file of points: its columns, by name. */
function readPly(buffer) {
  const start = new TextDecoder("latin1").decode(new Uint8Array(buffer, 0, Math.min(buffer.byteLength, 4096)));
  const end = start.indexOf("end_header\n") + 11, head = start.slice(0, end);
  const count = Number(/^element vertex (\d+)$/m.exec(head)[1]);
  const properties = [...head.matchAll(/^property (\w+) (\w+)$/gm)].map(([, kind, name]) => ({ kind, name }));
  const size = properties.reduce((sum, { kind }) => sum + (kind === "uchar" ? 1 : 4), 0);
  const view = new DataView(buffer, end), columns = { count };
  let offset = 0;
  for (const { kind, name } of properties) {
    const column = columns[name] = kind === "uchar" ? new Uint8Array(count) : new Float32Array(count);
    for (let row = 0; row < count; row++) {
      const at = row * size + offset;
      column[row] = kind === "uchar" ? view.getUint8(at) : view.getFloat32(at, true);
    }
    offset += kind === "uchar" ? 1 : 4;
  }
  return columns;
}

/* The links of a robot's model (URDF) by name, each with what is seen of it, and the names of the meshes, which are left out. */
function readModel(text) {
  const model = new DOMParser().parseFromString(text, "application/xml");
  if (model.querySelector("parsererror") || !model.querySelector("robot")) throw new Error("no URDF");
  for (const each of model.querySelectorAll("texture")) each.remove(); // it is a file of another machine
  const loader = new URDFLoader(), links = new Map();
  const meshes = [...model.querySelectorAll("visual > geometry > mesh")].map((each) => each.getAttribute("filename") ?? "");
  loader.packages = () => "";
  loader.loadMeshCb = () => {};
  for (const [name, link] of Object.entries(loader.parse(model).links)) {
    const group = new Group();
    for (const visual of link.children.filter(({ isURDFVisual }) => isURDFVisual)) {
      let isFinite = true;
      visual.updateMatrixWorld(true);
      visual.traverse(({ matrixWorld }) => { isFinite &&= matrixWorld.elements.every(Number.isFinite); });
      if (isFinite) group.add(visual);
    }
    links.set(name, group);
  }
  return { links, meshes };
}

/* Red, green and blue by point: those of the cloud, or by intensity, or by height. */
function shade({ count, z, red, green, blue, intensity }) {
  const found = new Float32Array(3 * count);
  if (red) {
    for (let row = 0; row < count; row++) {
      found.set([LINEAR[red[row]], LINEAR[green[row]], LINEAR[blue[row]]], 3 * row);
    }
    return found;
  }
  const values = intensity ?? z;
  let sum = 0, squares = 0, finite = 0;
  for (const each of values) {
    if (!Number.isFinite(each)) continue;
    finite++;
    sum += each;
    squares += each * each;
  }
  const mean = sum / (finite || 1), spread = Math.sqrt(Math.max(squares / (finite || 1) - mean * mean, 0)) || 1;
  const mixed = new Color();
  for (let row = 0; row < count; row++) {
    const share = Math.min(Math.max((values[row] - mean) / (4 * spread) + 0.5, 0), 1) || 0; // two deviations each way
    const place = Math.min(share * (RAMP.length - 1), RAMP.length - 1.001), lower = Math.floor(place);
    mixed.lerpColors(RAMP[lower], RAMP[lower + 1], place - lower).toArray(found, 3 * row);
  }
  return found;
}

class View extends SpaceView {
  constructor(figure, address) {
    super(figure, address);
    this.build();
  }

  build() {
    this.words = element("span", { textContent: "Not live yet" });
    this.words.setAttribute("role", "status");
    this.canvas = element("canvas", { tabIndex: 0 });
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "Three dimensions. Arrow keys move it, with shift they turn it, plus and minus zoom, 0 fits all in.");
    try {
      this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: true });
    } catch {
      this.words.textContent = "This browser has no WebGL, which three dimensions need. The content is listed below and shown from above.";
      this.figure.prepend(this.words);
      return;
    }
    const frames = element("input", { type: "checkbox", checked: true });
    frames.addEventListener("change", () => { this.frameGroup.visible = frames.checked; this.renew(); });
    this.count = element("select", {}, ...COUNTS.map((each) => element("option", { value: each, textContent: each.toLocaleString("en") })));
    this.count.value = 20000;
    this.count.addEventListener("change", () => this.things.forEach((thing) => thing.cloud && this.load(thing, thing.cloud)));
    this.controlsRow = element("div", { className: "controls" }, this.words,
      button("Fit", "Fit", () => { this.followNothing(); this.fit(); }),
      button("Above", "From above", () => { this.followNothing(); this.fit([0, -0.001, 1]); }),
      button("\u2212", "Zoom out", () => this.zoom(1.4)), button("+", "Zoom in", () => this.zoom(1 / 1.4)),
      this.chooseFollowed(), element("label", {}, "Points ", this.count),
      element("label", { className: "tick" }, frames, " Frames"));
    this.legend = element("ul", { className: "legend" });
    this.readout = element("p", { className: "readout" });
    this.absent = element("ul");
    this.absence = element("details", { hidden: true }, element("summary", { textContent: "Meshes not shown" }), this.absent);
    this.figure.prepend(this.controlsRow, this.canvas, this.readout, this.absence, this.legend);
    this.scene = new Scene();
    this.frameGroup = new Group();
    this.ruleGroup = new Group();
    this.modelGroup = new Group();
    const light = new DirectionalLight("#ffffff", 2);
    light.position.set(-2, -3, 5);
    this.scene.add(this.frameGroup, this.ruleGroup, this.modelGroup, new AmbientLight("#ffffff", 1.4), light);
    this.camera = new PerspectiveCamera(50, 1, 0.05, 20000);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(-4, -4, 4);
    this.links = new Map();
    this.listen();
    this.paint();
    if (this.figure.dataset.model) this.loadModel(this.figure.dataset.model);
  }

  listen() {
    const { canvas } = this, controls = this.controls = new OrbitControls(this.camera, canvas);
    controls.enableDamping = false;
    controls.enableZoom = false; // until it is clicked: the page scrolls
    controls.listenToKeyEvents(canvas);
    controls.addEventListener("change", () => this.renew());
    controls.addEventListener("start", () => { this.isMoved = true; });
    canvas.addEventListener("pointerdown", () => { canvas.focus(); controls.enableZoom = true; }, { capture: true });
    canvas.addEventListener("focus", () => { controls.enableZoom = true; });
    canvas.addEventListener("blur", () => { controls.enableZoom = false; });
    canvas.addEventListener("keydown", (event) => {
      if (event.key.startsWith("Arrow")) this.isMoved = true;
      else if (event.key === "+" || event.key === "=") this.zoom(0.8);
      else if (event.key === "-") this.zoom(1.25);
      else if (event.key === "0") {
        this.followNothing();
        this.fit();
      } else return;
      event.preventDefault();
    });
    canvas.addEventListener("webglcontextlost", () => this.say("The browser has closed the WebGL context"));
    new ResizeObserver(() => this.resize()).observe(canvas);
    isDark.addEventListener("change", () => this.paint());
  }

  colour(name) {
    return new Color(getComputedStyle(this.canvas).getPropertyValue(name).trim());
  }

  /* The colours of the page. */
  paint() {
    this.scene.background = this.colour("--card");
    this.paintRule();
    for (const thing of this.things) thing.tone?.set(this.colour(thing.colour));
    for (const thing of this.things) if (thing.drawing) this.draw(thing);
    this.drawFrames();
    this.renew();
  }

  /* The floor of the fixed frame: squares of a round number of metres; red is x, green y, blue z. */
  paintRule(extent = this.extent ?? 10) {
    this.extent = extent;
    const step = 10 ** Math.max(Math.ceil(Math.log10(extent / 20)), 0), cells = 2 * Math.ceil(extent / step);
    this.clear(this.ruleGroup);
    const grid = new GridHelper(cells * step, cells, this.colour("--edge"), this.colour("--line"));
    grid.rotation.x = Math.PI / 2;
    this.ruleGroup.add(grid, new AxesHelper(step));
    this.canvas.dataset.step = step;
  }

  clear(group) {
    for (const each of [...group.children]) {
      each.traverse((part) => {
        part.geometry?.dispose();
        part.material?.map?.dispose();
        part.material?.dispose();
      });
      group.remove(each);
    }
  }

  zoom(factor) {
    this.isMoved = true;
    const { position } = this.camera, { target } = this.controls;
    position.sub(target).multiplyScalar(factor).add(target);
    this.controls.update();
    this.renew();
  }

  /* All in the window that is drawn, seen from a direction; that of now where none is given. */
  fit(direction = null) {
    const box = new Box3();
    for (const { group } of this.things) if (group.visible && group.children.length) box.expandByObject(group);
    if (this.modelGroup.visible) for (const each of this.modelGroup.children) if (each.visible) box.expandByObject(each);
    for (const { pose } of this.frames.values()) box.expandByPoint(new Vector3(...pose.slice(0, 3)));
    if (box.isEmpty()) return;
    const sphere = box.getBoundingSphere(new Sphere()), radius = Math.max(sphere.radius, 0.5);
    const narrow = Math.min(this.camera.aspect, 1), angle = (this.camera.fov * Math.PI) / 360;
    const from = direction ? new Vector3(...direction) : this.camera.position.clone().sub(this.controls.target);
    this.controls.target.copy(sphere.center);
    this.camera.position.copy(sphere.center).addScaledVector(from.normalize(), radius / Math.sin(angle) / narrow);
    this.camera.near = radius / 500;
    this.camera.far = radius * 200;
    this.camera.updateProjectionMatrix();
    this.isMoved = false;
    this.paintRule(Math.min(Math.max(sphere.center.length() + radius, 2), 5000));
    this.controls.update();
    this.renew();
  }

  /* What comes */

  follow() {
    if (this.renderer) super.follow();
  }

  take({ show, frames, things }) {
    if (show) this.show(show);
    if (frames) {
      this.setFrames(frames);
      this.drawFrames();
    }
    let isNew = false;
    for (const each of things ?? []) isNew = this.set(this.things[each.place], each) || isNew;
    if (isNew && !this.isMoved && !this.followed) this.fit();
    this.renew();
  }

  /* What is followed is in the middle, seen from the same side and as far as before. */
  centre() {
    const pose = this.frames.get(this.followed)?.pose;
    if (!pose) return;
    const { target } = this.controls, way = new Vector3(...pose.slice(0, 3)).sub(target);
    if (way.length() < 1e-6) return; // the controls tell of each change, which would draw it again
    target.add(way);
    this.camera.position.add(way);
    this.controls.update();
  }

  show(list) {
    const known = new Map(this.things.map((each) => [each.href, each]));
    this.things = list.map((each, place) => {
      const thing = known.get(each.href) ?? { trace: [], group: new Group(), count: 0 };
      Object.assign(thing, each, { colour: `--line-${place % SpaceView.COLOURS}` });
      thing.tone = this.colour(thing.colour);
      if (!known.delete(each.href)) this.scene.add(thing.group);
      return thing;
    });
    for (const { group } of known.values()) {
      this.clear(group);
      this.scene.remove(group);
    }
    this.list();
  }

  toggle(thing) {
    this.place(thing);
  }

  /* Whether something is drawn that was not before. */
  set(thing, { drawing, pose, problem, picture, cloud }) {
    const isNew = pose !== null && !thing.pose;
    thing.pose = pose;
    thing.why.textContent = problem;
    if (drawing !== undefined) {
      thing.drawing = drawing;
      thing.count++;
      const last = thing.trace.at(-1), now = drawing?.trace && drawing.arrows[0];
      if (now && !(last && Math.hypot(now[0] - last[0], now[1] - last[1], now[2] - last[2]) < STEP)) thing.trace.push(now.slice(0, 3));
      if (thing.trace.length > TRACE) thing.trace = thing.trace.filter((_, place) => place % 2);
      if (cloud) this.load(thing, cloud);
      else this.draw(thing);
      if (picture) this.loadPicture(thing, picture);
    }
    this.place(thing);
    return isNew;
  }

  place(thing) {
    thing.group.visible = Boolean(thing.pose) && !thing.isHidden;
    if (!thing.pose) return;
    thing.group.position.set(...thing.pose.slice(0, 3));
    thing.group.quaternion.set(...thing.pose.slice(3));
  }

  /* One file of points at a time: the next is asked for when that is drawn. */
  async load(thing, address) {
    thing.cloud = address;
    if (thing.isLoading) return;
    thing.isLoading = true;
    const [own, most] = [address, this.count.value];
    try {
      const answer = await fetch(`${address}&points=${most}`, { headers: { accept: "application/octet-stream" } });
      if (!answer.ok) throw new Error(`${answer.status}`);
      const isFirst = !thing.columns;
      thing.columns = readPly(await answer.arrayBuffer());
      this.draw(thing);
      if (isFirst && !this.isMoved && !this.followed) this.fit();
      this.renew();
    } catch {
      thing.why.textContent = "The points cannot be loaded";
    }
    thing.isLoading = false;
    if (this.stream && (thing.cloud !== own || this.count.value !== most)) this.load(thing, thing.cloud);
  }

  loadPicture(thing, address) {
    thing.wanted = address;
    if (thing.isLoading) return;
    thing.isLoading = true;
    const done = (texture) => {
      thing.isLoading = false;
      if (texture) {
        texture.colorSpace = SRGBColorSpace;
        texture.magFilter = NearestFilter;
        thing.texture?.dispose();
        thing.texture = texture;
        this.draw(thing);
        this.renew();
      } else thing.why.textContent = "The picture of the grid cannot be loaded";
      if (thing.wanted !== address) this.loadPicture(thing, thing.wanted);
    };
    new TextureLoader().load(address, done, undefined, () => done(null));
  }

  /* The model of the robot: a text, or a JSON that is one. */
  async loadModel(address) {
    try {
      const answer = await fetch(address, { headers: { accept: "text/plain, application/json;q=0.5" } });
      if (!answer.ok) throw new Error(`${answer.status}`);
      const isJson = answer.headers.get("content-type").includes("json");
      const { links, meshes } = readModel(isJson ? await answer.json() : await answer.text());
      this.links = links;
      this.meshes = meshes.length;
      this.absence.hidden = !meshes.length;
      this.absent.replaceChildren(...[...new Set(meshes)].map((each) => element("li", { textContent: each })));
      this.modelGroup.add(...links.values());
    } catch {
      this.readout.textContent = "The model of the robot cannot be read.";
      return;
    }
    const model = element("input", { type: "checkbox", checked: true });
    model.addEventListener("change", () => { this.modelGroup.visible = model.checked; this.renew(); });
    this.controlsRow.append(element("label", { className: "tick" }, model, " Model"));
    this.placeModel();
    if (!this.isMoved && !this.followed) this.fit();
    this.renew();
  }

  /* Each link is where the frame of its name is. */
  placeModel() {
    if (!this.links.size) return;
    let missing = 0, drawn = 0;
    for (const [name, group] of this.links) {
      const pose = this.frames.get(name)?.pose;
      group.visible = Boolean(pose);
      if (!group.children.length) continue;
      if (!pose) missing++;
      else {
        drawn++;
        group.position.set(...pose.slice(0, 3));
        group.quaternion.set(...pose.slice(3));
      }
    }
    const words = [`Model: ${drawn} ${drawn === 1 ? "link" : "links"}`];
    if (this.meshes) words.push(`${this.meshes} ${this.meshes === 1 ? "mesh is" : "meshes are"} missing: boxes, cylinders and spheres are drawn`);
    if (missing) words.push(`${missing} without a frame`);
    const said = `${words.join("; ")}.`;
    if (this.readout.textContent !== said) this.readout.textContent = said;
  }

  /* What is drawn */

  draw(thing) {
    const { group, drawing, tone, columns } = thing;
    this.clear(group);
    if (!drawing) return;
    const lines = (made, positions, opacity = 1) => group.add(new made(geometry(positions),
      new LineBasicMaterial({ color: tone, opacity, transparent: opacity < 1 })));
    if (columns) this.drawPoints(group, columns, { vertexColors: true }, shade(columns));
    else if (drawing.points) this.drawPoints(group, { count: drawing.points.x.length, ...drawing.points }, { color: tone });
    if (drawing.line) {
      const { x, y, z, closed } = drawing.line;
      lines(closed ? LineLoop : Line, x.flatMap((each, row) => [each, y[row], z?.[row] ?? 0]));
    }
    if (drawing.arrows) lines(LineSegments, drawing.arrows.flatMap((each) => this.arrow(each, drawing.arrows.length > 1 ? 0.2 : 0.5)));
    if (drawing.ellipse) lines(LineLoop, this.ellipse(drawing.ellipse, drawing.arrows[0]), 0.6);
    if (drawing.trace && thing.trace.length > 1) lines(Line, thing.trace.flat(), 0.6);
    if (drawing.grid && thing.texture) this.drawGrid(group, drawing.grid, thing.texture);
  }

  drawPoints(group, { count, x, y, z }, how, colours = null) {
    const positions = new Float32Array(3 * count);
    for (let row = 0; row < count; row++) {
      positions[3 * row] = x[row];
      positions[3 * row + 1] = y[row];
      positions[3 * row + 2] = z ? z[row] : 0;
    }
    const made = geometry(positions);
    if (colours) made.setAttribute("color", new Float32BufferAttribute(colours, 3));
    const size = (count > 5000 ? 2 : 3) * Math.min(devicePixelRatio, 2);
    const points = new Points(made, new PointsMaterial({ size, sizeAttenuation: false, ...how }));
    points.userData.count = count;
    group.add(points);
  }

  /* An arrow along x, as lines. */
  arrow(pose, size) {
    const turn = new Quaternion(...pose.slice(3)), from = new Vector3(...pose.slice(0, 3));
    const at = (x, y) => new Vector3(x * size, y * size, 0).applyQuaternion(turn).add(from).toArray();
    return [at(0, 0), at(1, 0), at(1, 0), at(0.65, 0.25), at(1, 0), at(0.65, -0.25)].flat();
  }

  ellipse([major, minor, angle], [x, y, z]) {
    return Array.from({ length: 48 }, (_, each) => {
      const turn = (each / 24) * Math.PI, [along, aside] = [major * Math.cos(turn), minor * Math.sin(turn)];
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      return [x + along * c - aside * s, y + along * s + aside * c, z];
    }).flat();
  }

  /* The texture is of the thing, whose next drawing has it again: a copy of its own is disposed of with the mesh. */
  drawGrid(group, { origin, size: [width, height] }, texture) {
    const material = new MeshBasicMaterial({ map: texture.clone(), transparent: true, depthWrite: false, side: DoubleSide });
    if (isDark.matches) material.color.setScalar(0.35);
    const mesh = new Mesh(new PlaneGeometry(width, height).translate(width / 2, height / 2, 0), material);
    mesh.position.set(...origin.slice(0, 3));
    mesh.quaternion.set(...origin.slice(3));
    mesh.renderOrder = -1;
    group.add(mesh);
  }

  /* Their axes, and beside them their names; and the model, which is where they are. */
  drawFrames() {
    this.placeModel();
    const names = [...this.frames.keys()].join("\n") + isDark.matches;
    if (names !== this.drawnNames) {
      this.drawnNames = names;
      this.clear(this.frameGroup);
      for (const name of this.frames.keys()) {
        const axes = new AxesHelper(0.4);
        axes.add(this.sign(name));
        this.frameGroup.add(axes);
      }
    }
    const all = [...this.frames.values()];
    all.forEach(({ pose }, place) => {
      /* Names of frames that are close to each other stand below each other. */
      const isClose = (each) => Math.hypot(...[0, 1, 2].map((axis) => each.pose[axis] - pose[axis])) < 0.35;
      this.frameGroup.children[place].children[0].center.y = 0.2 + all.slice(0, place).filter(isClose).length;
      this.frameGroup.children[place].position.set(...pose.slice(0, 3));
      this.frameGroup.children[place].quaternion.set(...pose.slice(3));
    });
  }

  sign(name) {
    const canvas = element("canvas"), context = canvas.getContext("2d"), font = "600 28px sans-serif";
    context.font = font;
    canvas.width = Math.min(Math.ceil(context.measureText(name).width) + 12, 1000);
    canvas.height = 40;
    context.font = font;
    context.lineWidth = 6;
    context.strokeStyle = `#${this.colour("--card").getHexString()}`;
    context.fillStyle = `#${this.colour("--ink").getHexString()}`;
    context.strokeText(name, 6, 30);
    context.fillText(name, 6, 30);
    const map = new CanvasTexture(canvas);
    map.colorSpace = SRGBColorSpace;
    const sprite = new Sprite(new SpriteMaterial({ map, sizeAttenuation: false, depthTest: false, transparent: true }));
    sprite.center.set(-0.04, 0.2);
    sprite.scale.set((0.036 * canvas.width) / canvas.height, 0.036, 1);
    return sprite;
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    if (!clientWidth || !clientHeight) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    this.renew();
  }

  renew() {
    if (this.isStale) return;
    this.isStale = true;
    requestAnimationFrame(() => {
      this.centre();
      this.isStale = false;
      this.renderer.render(this.scene, this.camera);
      const shown = this.things.filter(({ group }) => group.visible && group.children.length);
      const points = shown.flatMap(({ group }) => group.children.map(({ userData }) => userData.count ?? 0));
      this.canvas.dataset.points = points.reduce((sum, each) => sum + each, 0);
      this.canvas.dataset.camera = this.camera.position.toArray().map((each) => each.toFixed(2)).join(" ");
      this.canvas.dataset.messages = this.things.reduce((sum, { count }) => sum + count, 0);
      this.canvas.dataset.things = shown.map(({ label }) => label).join(" ");
    });
  }
}

SpaceView.watch("space3d", View);
