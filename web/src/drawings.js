// What a result looks like where it is: grids on the floor, clouds of points, and why a condition holds.

import * as THREE from "three";

// Above the floor, so that it is seen, m.
const GAP = 0.004;
// The size of a point, pixels.
const POINT = 3;
const MAX_OPACITY = 0.85;
// Of conditions: the colours, the size of a point, and of the letters of a label, pixels.
const [HOLDS, FAILS] = [0x1a7f37, 0xcf222e];
const END = 7;
const LABEL = 48;
// The height of a label, as a part of what the camera sees at a distance of 1.
const LABEL_HEIGHT = 0.036;
// Labels that are nearer to each other are one below the other, m.
const APART = 0.2;

export function gridOf({ origin, resolution, shape, shares }, floor) {
  const [columns, rows] = shape;
  const cells = bytesOf(shares);
  const pixels = new Uint8Array(4 * columns * rows);
  for (let x = 0; x < columns; x++) {
    for (let y = 0; y < rows; y++) {
      const share = cells[x * rows + y] / 255;
      const place = 4 * (y * columns + x);
      pixels[place] = 255 - 60 * share;
      pixels[place + 1] = 255 - 190 * share;
      pixels[place + 2] = 255 - 235 * share;
      pixels[place + 3] = 255 * (share ? 0.35 + (MAX_OPACITY - 0.35) * share : 0.3);
    }
  }
  const texture = new THREE.DataTexture(pixels, columns, rows);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.magFilter = texture.minFilter = THREE.NearestFilter;
  texture.needsUpdate = true;
  const material = new THREE.MeshBasicMaterial({ map: texture, transparent: true, depthWrite: false });
  material.side = THREE.DoubleSide;
  const [width, height] = [columns * resolution, rows * resolution];
  const mesh = new THREE.Mesh(new THREE.PlaneGeometry(width, height), material);
  mesh.position.set(origin[0] + width / 2, origin[1] + height / 2, floor + GAP);
  mesh.renderOrder = 1;
  return mesh;
}

export function cloudOf({ points, owners, size }, palette) {
  const places = new Float32Array(bytesOf(points).buffer);
  const numbers = new Uint32Array(bytesOf(owners).buffer);
  const colours = new Float32Array(places.length);
  numbers.forEach((number, index) => {
    const colour = palette[number % palette.length].clone().offsetHSL(0, 0.35, 0);
    colour.toArray(colours, 3 * index);
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
  geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  const kind = size === null ? { size: POINT * window.devicePixelRatio, sizeAttenuation: false } : { size };
  const material = new THREE.PointsMaterial({ ...kind, vertexColors: true });
  return new THREE.Points(geometry, material);
}

// The parts of a condition: for each its two points, the line between them, and its margin beside it.
export function reasonsOf(parts) {
  const drawn = parts.flatMap(reasonOf);
  const labels = drawn.filter((each) => each.isSprite);
  labels.forEach((label, index) => {
    const above = labels.slice(0, index).filter((each) => each.position.distanceTo(label.position) < APART);
    label.center.set(0, 0.5 + above.length);
  });
  return drawn;
}

function reasonOf({ points, value, margin }) {
  const colour = value ? HOLDS : FAILS;
  const line = new THREE.BufferGeometry().setFromPoints(points.map((each) => new THREE.Vector3(...each)));
  const seen = { color: colour, depthTest: false, transparent: true };
  const size = { size: END * window.devicePixelRatio, sizeAttenuation: false };
  const parts = [
    new THREE.Line(line, new THREE.LineBasicMaterial(seen)),
    new THREE.Points(line, new THREE.PointsMaterial({ ...seen, ...size })),
  ];
  if (margin !== null) parts.push(labelOf(`${value ? "✓" : "✗"} ${Number(margin.toPrecision(3))} m`, colour, line));
  for (const each of parts) each.renderOrder = 3;
  return parts;
}

// A text that faces the eye, of one size on the screen, right of the middle of a line.
function labelOf(text, colour, line) {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d");
  const font = `600 ${LABEL}px system-ui, sans-serif`;
  context.font = font;
  canvas.width = context.measureText(text).width + LABEL;
  canvas.height = 1.5 * LABEL;
  context.font = font;
  context.textBaseline = "middle";
  context.lineWidth = LABEL / 5;
  context.strokeStyle = "#ffffff";
  context.fillStyle = `#${new THREE.Color(colour).getHexString()}`;
  context.strokeText(text, LABEL / 2, canvas.height / 2);
  context.fillText(text, LABEL / 2, canvas.height / 2);
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map, depthTest: false, sizeAttenuation: false }));
  sprite.scale.set((LABEL_HEIGHT * canvas.width) / canvas.height, LABEL_HEIGHT, 1);
  line.computeBoundingBox();
  line.boundingBox.getCenter(sprite.position);
  return sprite;
}

function bytesOf(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}
