// Places and cameras (SPEC.md 14.2) in the conventions of browser graphics.

// From the frame of 14.2 (x right, y down, z into the scene) to that of OpenGL.
const FLIP = [1, -1, -1];

// For each value of up_axis: the number and the sign of the axes to which x, y and z of the scene turn.
const UPRIGHT = [
  [[1, 1], [0, -1], [2, 1]],
  [[1, -1], [0, 1], [2, 1]],
  [[0, 1], [1, 1], [2, 1]],
  [[0, 1], [1, -1], [2, -1]],
  [[0, 1], [2, -1], [1, 1]],
  [[0, 1], [2, 1], [1, -1]],
];

// 14.2 and 14.4, ROTATION: by rows, from the world to the camera
export function rotationOf({ rotation }) {
  // The quaternion is scaled first, because squares of large numbers are infinite.
  const most = Math.max(...rotation.map(Math.abs));
  const scaled = rotation.map((part) => part / most);
  const length = Math.hypot(...scaled);
  const [w, x, y, z] = scaled.map((part) => part / length);
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

function statedCentre({ rotation, translation }) {
  const rows = rotationOf({ rotation });
  return [0, 1, 2].map((axis) => -rows.reduce((sum, row, i) => sum + row[axis] * translation[i], 0));
}

function placeOf(camera) {
  if (camera?.matrixWorld !== undefined) return Array.from(camera.matrixWorld.elements).slice(12, 15);
  if (camera?.rotation !== undefined && camera.translation !== undefined) return statedCentre(camera);
  if (camera?.x !== undefined) return [camera.x, camera.y, camera.z];
  return camera?.length === 3 ? Array.from(camera) : [];
}

// A point of the world in the coordinates of an object. elements: the object's matrix, column by column.
function within(elements, point) {
  const [a, b, c, from] = [0, 4, 8, 12].map((at) => Array.from(elements).slice(at, at + 3));
  const cross = (p, q) => [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
  const dot = (p, q) => p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
  const away = point.map((x, i) => x - from[i]);
  const volume = dot(a, cross(b, c));
  return [dot(away, cross(b, c)) / volume, dot(away, cross(c, a)) / volume, dot(away, cross(a, b)) / volume];
}

export function centreOf(camera, object) {
  const place = placeOf(camera);
  const own = object === undefined ? place : within(object.matrixWorld.elements, place);
  if (own.length !== 3 || !own.every(Number.isFinite)) throw new TypeError("the camera has no place of finite numbers");
  return Float64Array.from(own);
}

export function cameraMatrix(camera) {
  const rows = rotationOf(camera);
  const matrix = new Float64Array(16);
  rows.forEach((row, column) => row.forEach((value, axis) => (matrix[4 * column + axis] = FLIP[column] * value)));
  matrix.set(statedCentre(camera), 12);
  matrix[15] = 1;
  return matrix;
}

export function projectionMatrix({ width, height, focal, principal_point: middle }, near, far) {
  const matrix = new Float64Array(16);
  matrix[0] = (2 * focal[0]) / width;
  matrix[5] = (2 * focal[1]) / height;
  matrix[8] = 1 - (2 * middle[0]) / width;
  matrix[9] = (2 * middle[1]) / height - 1;
  matrix[10] = (far + near) / (near - far);
  matrix[11] = -1;
  matrix[14] = (2 * far * near) / (near - far);
  return matrix;
}

export function uprightMatrix({ up_axis: up }) {
  const matrix = new Float64Array(16);
  UPRIGHT[up].forEach(([axis, sign], column) => (matrix[4 * column + axis] = sign));
  matrix[15] = 1;
  return matrix;
}
