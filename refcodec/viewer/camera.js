// Cameras of the page: a movable pose, and a lens (SPEC.md 14.2).
//
// A pose has `rotation`, nine numbers row by row from the world to the camera, `centre`, its place in the world, and
// `pivot`, the distance to the point that it turns around. x points right, y down and z into the scene. A lens has the
// size of its image, and focal and principal_point in pixels.
import { rotationOf } from "../web/camera.js";

const add = (a, b, times = 1) => a.map((x, i) => x + times * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / Math.hypot(...a));
const row = (rotation, i) => rotation.slice(3 * i, 3 * i + 3);

// The default camera of a scene without cameras, and its lens: those of `refcodec render --cameras orbit`.
const LENS = { width: 800, height: 600, focal: [700, 700], principal_point: [400, 300] };
const ELEVATION = (25 * Math.PI) / 180;
const DISTANCE = 2.2;
// The largest ratio of two aspect ratios at which the whole image is shown.
const SHAPES = 1.8;
// The least angle between the view and the up axis, in radians.
const STEEPEST = 0.02;
// The limits at which image rows define the up direction, as in refcodec.rendering.camera, and the iterations.
const [ROWS_SPREAD, ROWS_LEVEL, POWERS] = [0.05, 0.25, 1000];

// The lens of a camera, of the file or of a photograph.
export function lensOf({ width, height, focal, principal_point }) {
  return { width, height, focal: [...focal], principal_point: [...principal_point] };
}

// The pose of a camera. Its rotation is a quaternion w, x, y, z or a matrix. middle, radius: of the scene.
export function poseOf({ rotation, translation }, { middle, radius }) {
  const matrix = rotation.length === 9 ? [...rotation] : rotationOf({ rotation }).flat();
  const columns = [0, 1, 2].map((i) => [matrix[i], matrix[3 + i], matrix[6 + i]]);
  const centre = columns.map((column) => -dot(column, translation));
  // It turns around the point ahead at the distance of the scene middle.
  const depth = dot(row(matrix, 2), add(middle, centre, -1));
  return { rotation: matrix, centre, pivot: depth > 0.05 * radius ? depth : radius };
}

// The cameras of a file by their distance from the first one, the default view. A file lists distant ones first.
export function nearestFirst(cameras) {
  const [first, ...places] = cameras.map((camera) => poseOf(camera, { middle: [0, 0, 0], radius: 1 }).centre);
  const far = new Map(cameras.slice(1).map((camera, i) => [camera, Math.hypot(...add(places[i], first, -1))]));
  return [...cameras.slice(0, 1), ...[...far.keys()].sort((a, b) => far.get(a) - far.get(b))];
}

// The up direction, as in refcodec.rendering.view.scene_up: the axis of 6.5, or more precisely the normal of the image
// rows of the cameras, which levels the horizon.
export function upOf({ up_axis }, cameras = []) {
  const axis = [0, 0, 0];
  axis[up_axis >> 1] = up_axis % 2 ? -1 : 1;
  const rows = cameras.map(({ rotation }) => rotationOf({ rotation })[0]);
  // The mean of their outer products. Power iteration from the axis gives its least eigenvector.
  const squares = [0, 1, 2].map((i) => [0, 1, 2].map((j) => rows.reduce((sum, r) => sum + r[i] * r[j], 0) / rows.length));
  let up = unit(axis.map((x, i) => x + 0.01 * (i + 1)));
  for (let i = 0; i < POWERS; i++) up = unit(up.map((x, k) => x - dot(squares[k], up)));
  const least = dot(up, squares.map((r) => dot(r, up)));
  const minor = (i, j) => squares[i][i] * squares[j][j] - squares[i][j] ** 2;
  // The trace is 1. These are the sum of the two other eigenvalues, and the smaller one.
  const sum = 1 - least;
  const product = minor(0, 1) + minor(0, 2) + minor(1, 2) - least * sum;
  const middle = (sum - Math.sqrt(Math.max(0, sum * sum - 4 * product))) / 2;
  if (!(middle >= ROWS_SPREAD && least <= ROWS_LEVEL * middle)) return axis;
  if (dot(up, axis) < 0) up = up.map((x) => -x);
  return up.every((x) => Math.abs(x) <= dot(up, axis)) ? up : axis;
}

// A camera that looks at the middle of a scene from above.
export function around({ middle, radius }, up) {
  const side = [up[2], up[0], up[1]];
  const away = side.map((x, i) => Math.cos(ELEVATION) * x + Math.sin(ELEVATION) * up[i]);
  const z = away.map((x) => -x);
  const x = unit(cross(z, up));
  const pivot = DISTANCE * radius;
  return { lens: LENS, pose: { rotation: [...x, ...cross(z, x), ...z], centre: add(middle, away, pivot), pivot } };
}

// The lens that shows an image in the middle of a larger one, and its place: left, top and scale.
//
// The whole image is shown, unless the aspect ratios differ much, as on a phone.
export function fitted({ width, height, focal, principal_point }, [wide, high]) {
  const [across, down] = [wide / width, high / height];
  const scale = Math.max(Math.min(across, down), Math.max(across, down) / SHAPES);
  const [left, top] = [(wide - width * scale) / 2, (high - height * scale) / 2];
  const lens = {
    width: wide,
    height: high,
    focal: focal.map((x) => x * scale),
    principal_point: [principal_point[0] * scale + left, principal_point[1] * scale + top],
  };
  return { lens, left, top, scale };
}

// The matrix of a turn around a unit axis.
function turning([x, y, z], angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const t = 1 - c;
  return [
    [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
    [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
    [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
  ];
}

function turned({ rotation, centre, pivot }, axis, angle) {
  const matrix = turning(axis, angle);
  const rows = [0, 1, 2].map((i) => matrix.map((own) => dot(own, row(rotation, i))));
  // Rounding errors would accumulate.
  const z = unit(rows[2]);
  const x = unit(cross(rows[1], z));
  return { rotation: [...x, ...cross(z, x), ...z], centre, pivot };
}

// Turns the view around the up axis by the first angle, and up or down by the second one.
export function look(pose, up, [aside, above]) {
  const level = turned(pose, up, aside);
  const rise = Math.asin(Math.max(-1, Math.min(1, dot(row(level.rotation, 2), up))));
  const most = Math.PI / 2 - STEEPEST;
  // A camera of a file may look straight down.
  const [low, high] = [Math.min(-most - rise, 0), Math.max(most - rise, 0)];
  return turned(level, row(level.rotation, 0), Math.max(low, Math.min(high, above)));
}

// The same around the point ahead of the camera.
export function orbit(pose, up, angles) {
  const point = add(pose.centre, row(pose.rotation, 2), pose.pivot);
  const found = look(pose, up, angles);
  return { ...found, centre: add(point, row(found.rotation, 2), -pose.pivot) };
}

// Turns the view to a point, which becomes the pivot.
export function facing(pose, point) {
  const [ahead, way] = [row(pose.rotation, 2), add(point, pose.centre, -1)];
  const axis = cross(ahead, unit(way));
  const sine = Math.hypot(...axis);
  const found = sine > 1e-9 ? turned(pose, unit(axis), Math.atan2(sine, dot(ahead, unit(way)))) : pose;
  return { ...found, pivot: Math.hypot(...way) };
}

// Moves by lengths to the right, down and forwards.
export function moved(pose, lengths) {
  const way = lengths.reduce((sum, length, i) => add(sum, row(pose.rotation, i), length), [0, 0, 0]);
  return { ...pose, centre: add(pose.centre, way) };
}

// Moves towards the pivot, or away from it.
export function nearer(pose, factor) {
  const pivot = Math.max(pose.pivot * factor, 1e-6);
  return { ...moved(pose, [0, 0, pose.pivot - pivot]), pivot };
}
