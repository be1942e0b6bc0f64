// The world in 3-D: a batched mesh of opaque shapes and one of transparent shapes, an instance a shape.
// It is drawn only when something changed.

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { toCreasedNormals } from "three/examples/jsm/utils/BufferGeometryUtils.js";
import { cloudOf, gridOf, reasonsOf } from "./drawings.js";

const BACKGROUND = 0xe9edf2;
const HIGHLIGHT = new THREE.Color(0xff6a13);
const DIMMED = new THREE.Color(0xc3cad3);
const GROUND = new THREE.Color(0xd5dbe2);
const GROUND_SIZE = 60;
const FLOOR_SAMPLES = 6;
// A transparent shape that stands out is at least as opaque as this.
const MARKED_ALPHA = 0.6;
const PALETTE = [
  0x6f8fb3, 0xb38f6f, 0x7fa88a, 0xa88aa0, 0x9a9f6d, 0x6fa3a8, 0xb3807a, 0x8286b5, 0xa3a3a3, 0xc2a878,
].map((hex) => new THREE.Color(hex));

export class Scene {
  constructor(element, onPick) {
    this.element = element;
    this.renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.autoUpdate = false;
    element.append(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(BACKGROUND);
    this.camera = new THREE.PerspectiveCamera(50, 1, 0.02, 200);
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, this.renderer.domElement);
    this.orbit.addEventListener("change", () => this.draw());
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0xb8b2a8, 1.7));
    this.sun = new THREE.DirectionalLight(0xffffff, 1.9);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 2048);
    this.sun.shadow.normalBias = 0.03;
    this.scene.add(this.sun, this.sun.target);
    this.lines = new THREE.LineSegments(
      new THREE.BufferGeometry(),
      new THREE.LineBasicMaterial({ color: 0xd1003f, depthTest: false }),
    );
    this.lines.renderOrder = 2;
    this.lines.frustumCulled = false;
    this.scene.add(this.lines);
    this.boxes = new THREE.Group();
    this.drawn = new THREE.Group();
    this.scene.add(this.boxes, this.drawn);
    this.batches = [];
    this.marks = null;
    this.hasCloud = false;
    this.selected = null;
    this.framesDrawn = 0;
    this.waiting = [];
    new ResizeObserver(() => this.resize()).observe(element);
    this.listenToClicks(onPick);
    this.resize();
  }

  listenToClicks(onPick) {
    const canvas = this.renderer.domElement;
    let start = null;
    canvas.addEventListener("pointerdown", (event) => (start = [event.clientX, event.clientY]));
    canvas.addEventListener("pointerup", (event) => {
      if (start && Math.hypot(event.clientX - start[0], event.clientY - start[1]) < 4) {
        onPick(this.entityAt(event.clientX, event.clientY));
      }
      start = null;
    });
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  draw() {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.renderer.render(this.scene, this.camera);
      this.framesDrawn += 1;
      for (const done of this.waiting.splice(0)) done();
    });
  }

  // Calls a function when what is to be drawn now was drawn.
  afterDrawing(done) {
    this.waiting.push(done);
    this.draw();
  }

  // -- what is shown

  show(head) {
    const isFirst = !this.head;
    this.head = head;
    for (const batch of this.batches) {
      this.scene.remove(batch);
      batch.dispose();
      batch.material.dispose();
    }
    const geometries = head.geometries.map((each) => geometryOf(each, head));
    const drawn = head.shapes.filter(([, , , colour]) => !colour || colour[3] > 0.02);
    const isClear = ([, number, , colour]) => !!colour && colour[3] < 1 && head.geometries[number].type !== "plane";
    const solid = batchOf(drawn.filter((each) => !isClear(each)), geometries, false);
    const clear = batchOf(drawn.filter(isClear), geometries, true);
    this.batches = [solid, clear].map(({ batch }) => batch);
    this.poses = new Float32Array(7 * head.links.length);
    this.shapesOfLink = head.links.map(() => []);
    this.entities = new Map(head.entities.map((each) => [each.id, each]));
    const order = new Map(head.entities.map((each, index) => [each.id, index]));
    this.shapes = drawn.map((each, index) => {
      const [row, number, pose, colour] = each;
      const isPlane = head.geometries[number].type === "plane";
      const [entity, link] = head.links[row];
      const plain = isPlane
        ? GROUND
        : colour
          ? new THREE.Color().setRGB(colour[0], colour[1], colour[2], THREE.SRGBColorSpace)
          : PALETTE[order.get(entity) % PALETTE.length];
      const local = matrixOf(pose, 0);
      if (isPlane) local.multiply(new THREE.Matrix4().makeTranslation(0, 0, -0.001));
      const { batch, ids } = isClear(each) ? clear : solid;
      const instance = batch.addInstance(ids.get(number));
      const alpha = isClear(each) ? colour[3] : 1;
      this.shapesOfLink[row].push(index);
      return { row, entity, link, local, plain, alpha, batch, instance, isPlane };
    });
    for (const each of geometries) each.dispose();
    this.scene.add(...this.batches);
    this.paint();
    if (isFirst) this.isFitted = false;
  }

  // Shows a tick of a track: the poses of all links of its first tick, and those that move.
  showTrack(track, index, isNew) {
    if (isNew) this.move(track.all, track.base);
    const size = 7 * track.rows.length;
    const start = size * (index - track.first);
    this.move(track.rows, track.poses.subarray(start, start + size));
  }

  move(rows, poses) {
    for (let i = 0; i < rows.length; i++) {
      const row = rows[i];
      this.poses.set(poses.subarray(7 * i, 7 * i + 7), 7 * row);
      const link = matrixOf(this.poses, 7 * row);
      for (const index of this.shapesOfLink[row]) {
        const shape = this.shapes[index];
        shape.batch.setMatrixAt(shape.instance, link.clone().multiply(shape.local));
      }
    }
    if (!this.isFitted) this.fit();
    if (rows.length) this.renderer.shadowMap.needsUpdate = true;
    this.draw();
  }

  // Lights fit what there is, without the ground; the camera is that of the world.
  fit() {
    this.isFitted = true;
    const box = this.bounds();
    const centre = box.getCenter(new THREE.Vector3());
    const radius = Math.max(0.5, box.getSize(new THREE.Vector3()).length() / 2);
    this.sun.target.position.copy(centre);
    this.sun.position.copy(centre).add(new THREE.Vector3(0.5, -0.7, 1.6).multiplyScalar(radius * 1.5));
    Object.assign(this.sun.shadow.camera, {
      left: -radius, right: radius, top: radius, bottom: -radius, near: 0.01, far: radius * 6,
    });
    this.sun.shadow.camera.updateProjectionMatrix();
    this.camera.far = radius * 40;
    const { eye, target, fov } = this.head.camera;
    this.camera.fov = fov;
    this.camera.position.set(...eye);
    this.orbit.target.set(...target);
    this.camera.updateProjectionMatrix();
    this.orbit.update();
  }

  bounds() {
    const box = new THREE.Box3();
    const part = new THREE.Box3();
    const matrix = new THREE.Matrix4();
    for (const shape of this.shapes.filter((each) => !each.isPlane)) {
      shape.batch.getBoundingBoxAt(shape.batch.getGeometryIdAt(shape.instance), part);
      shape.batch.getMatrixAt(shape.instance, matrix);
      part.applyMatrix4(matrix);
      if (Number.isFinite(part.min.x + part.max.x + part.min.y + part.max.z)) box.union(part);
    }
    return box.isEmpty() ? box.set(new THREE.Vector3(-1, -1, 0), new THREE.Vector3(1, 1, 1)) : box;
  }

  // -- what stands out

  // marks: [[entity, link or -1], …]; lines: [[point, point], …]; boxes: [[entity, x y z x y z], …]
  mark(marks, lines, boxes = []) {
    for (const each of this.boxes.children) each.geometry.dispose();
    this.boxes.clear();
    for (const [, x, y, z, ...high] of boxes) {
      const box = new THREE.Box3(new THREE.Vector3(x, y, z), new THREE.Vector3(...high));
      if (Number.isFinite(x + y + z + high[0] + high[1] + high[2])) {
        this.boxes.add(new THREE.Box3Helper(box, 0xff6a13));
      }
    }
    const hosted = marks.map(([entity, link]) => {
      const known = this.entities?.get(entity);
      return known && known.kind === "sensor" ? [known.host, -1] : [entity, link];
    });
    this.marks = hosted.length ? hosted : null;
    const points = lines.flat().map((each) => new THREE.Vector3(...each));
    this.lines.geometry.dispose();
    this.lines.geometry = new THREE.BufferGeometry().setFromPoints(points);
    this.paint();
  }

  // Draws a grid on the floor, points or the parts of a condition in the scene; null for nothing.
  draw3d(drawing) {
    for (const each of this.drawn.children) {
      each.geometry.dispose();
      each.material.map?.dispose();
      each.material.dispose();
    }
    this.drawn.clear();
    if (drawing?.kind === "grid") {
      const [width, height] = drawing.shape.map((count) => count * drawing.resolution);
      this.drawn.add(gridOf(drawing, this.floorAt(...drawing.origin, width, height)));
    }
    this.hasCloud = drawing?.kind === "cloud";
    if (this.hasCloud) this.drawn.add(cloudOf(drawing, PALETTE));
    if (drawing?.kind === "why") for (const each of reasonsOf(drawing.parts)) this.drawn.add(each);
    this.paint();
  }

  // The height of the floor below a rectangle, m: the lowest surface that looks up, at most places.
  floorAt(x, y, width, height) {
    const ray = new THREE.Raycaster();
    const top = this.bounds().max.z + 1;
    const heights = [];
    for (let i = 0.5; i < FLOOR_SAMPLES; i++) {
      for (let j = 0.5; j < FLOOR_SAMPLES; j++) {
        const from = new THREE.Vector3(x + (width * i) / FLOOR_SAMPLES, y + (height * j) / FLOOR_SAMPLES, top);
        ray.set(from, new THREE.Vector3(0, 0, -1));
        const hits = ray.intersectObjects(this.batches).filter((each) => each.face.normal.z > 0.5);
        if (hits.length) heights.push(hits[hits.length - 1].point.z);
      }
    }
    heights.sort((a, b) => a - b);
    return heights.length ? heights[heights.length >> 1] : 0;
  }

  select(entity) {
    this.selected = entity;
    this.paint();
  }

  paint() {
    if (!this.shapes) return;
    const whole = new Set((this.marks ?? []).filter((each) => each[1] < 0).map((each) => each[0]));
    const parts = new Set((this.marks ?? []).map(([entity, link]) => `${entity}/${link}`));
    const colour = new THREE.Color();
    for (const shape of this.shapes) {
      const isMarked = whole.has(shape.entity) || parts.has(`${shape.entity}/${shape.link}`);
      colour.copy(shape.plain);
      if (isMarked) colour.lerp(HIGHLIGHT, 0.8);
      else if ((this.marks || this.hasCloud) && !shape.isPlane) colour.lerp(DIMMED, 0.8);
      if (shape.entity === this.selected && !isMarked && !shape.isPlane) colour.lerp(new THREE.Color(0x2f7df6), 0.6);
      const alpha = isMarked ? Math.max(shape.alpha, MARKED_ALPHA) : shape.alpha;
      shape.batch.setColorAt(shape.instance, new THREE.Vector4(colour.r, colour.g, colour.b, alpha));
    }
    this.draw();
  }

  // -- where things are

  entityAt(x, y) {
    if (!this.shapes) return null;
    const box = this.renderer.domElement.getBoundingClientRect();
    const point = new THREE.Vector2(
      ((x - box.left) / box.width) * 2 - 1,
      1 - ((y - box.top) / box.height) * 2,
    );
    const ray = new THREE.Raycaster();
    ray.setFromCamera(point, this.camera);
    const hit = ray.intersectObjects(this.batches).find((each) => each.batchId !== undefined);
    return hit ? this.shapes.find((each) => each.batch === hit.object && each.instance === hit.batchId).entity : null;
  }

  // Returns the pose of the base of an entity, x y z w x y z.
  poseOf(name) {
    const entity = this.head.entities.find((each) => each.name === name);
    const row = entity ? this.head.links.findIndex((each) => each[0] === entity.id) : -1;
    return row < 0 ? null : [...this.poses.subarray(7 * row, 7 * row + 7)];
  }

  // Returns a place on the screen at which an entity is seen, in pixels of the page.
  placeOf(name) {
    const entity = this.head.entities.find((each) => each.name === name);
    const box = this.renderer.domElement.getBoundingClientRect();
    const step = 12;
    for (let y = box.top + step; y < box.bottom; y += step) {
      for (let x = box.left + step; x < box.right; x += step) {
        if (entity && this.entityAt(x, y) === entity.id) return [x, y];
      }
    }
    return null;
  }
}

function matrixOf(pose, at) {
  return new THREE.Matrix4().compose(
    new THREE.Vector3(pose[at], pose[at + 1], pose[at + 2]),
    new THREE.Quaternion(pose[at + 4], pose[at + 5], pose[at + 6], pose[at + 3]),
    new THREE.Vector3(1, 1, 1),
  );
}

// Returns a batched mesh for some shapes, with its geometries by their numbers.
function batchOf(shapes, geometries, isTransparent) {
  const numbers = [...new Set(shapes.map(([, number]) => number))];
  const count = (key) => numbers.reduce((sum, number) => sum + key(geometries[number]), 0);
  const material = new THREE.MeshStandardMaterial({
    roughness: 0.75, side: THREE.DoubleSide, transparent: isTransparent, depthWrite: !isTransparent,
    // Points on a surface are in front of it.
    polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
  });
  const batch = new THREE.BatchedMesh(
    Math.max(1, shapes.length),
    Math.max(3, count((each) => each.attributes.position.count)),
    Math.max(3, count((each) => each.index.count)),
    material,
  );
  batch.castShadow = !isTransparent;
  batch.receiveShadow = true;
  batch.perObjectFrustumCulled = false;
  batch.sortObjects = isTransparent;
  batch.frustumCulled = false;
  return { batch, ids: new Map(numbers.map((number) => [number, batch.addGeometry(geometries[number])])) };
}

function geometryOf({ type, size, vertices, faces }, head) {
  let geometry;
  if (type === "box") geometry = new THREE.BoxGeometry(...size);
  else if (type === "sphere") geometry = new THREE.SphereGeometry(size[0], 32, 20);
  else if (type === "cylinder") {
    geometry = new THREE.CylinderGeometry(size[0], size[0], size[1], 40).rotateX(Math.PI / 2);
  } else if (type === "capsule") {
    geometry = new THREE.CapsuleGeometry(size[0], size[1], 10, 32).rotateX(Math.PI / 2);
  } else if (type === "plane") {
    const turn = new THREE.Quaternion().setFromUnitVectors(
      new THREE.Vector3(0, 0, 1),
      new THREE.Vector3(...size).normalize(),
    );
    geometry = new THREE.PlaneGeometry(GROUND_SIZE, GROUND_SIZE).applyQuaternion(turn);
  } else {
    const mesh = new THREE.BufferGeometry();
    const points = head.vertices.slice(3 * vertices[0], 3 * (vertices[0] + vertices[1]));
    const corners = head.faces.slice(3 * faces[0], 3 * (faces[0] + faces[1]));
    mesh.setAttribute("position", new THREE.BufferAttribute(points, 3));
    mesh.setIndex(new THREE.BufferAttribute(corners, 1));
    geometry = toCreasedNormals(mesh, 0.7);
    mesh.dispose();
  }
  if (!geometry.index) {
    const count = geometry.attributes.position.count;
    geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from({ length: count }, (_, i) => i), 1));
  }
  for (const name of Object.keys(geometry.attributes)) {
    if (name !== "position" && name !== "normal") geometry.deleteAttribute(name);
  }
  return geometry;
}
