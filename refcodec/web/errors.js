// The registry of errors (SPEC.md 10.3), and the errors of this package.

// code, name, class, clause
const ROWS = `
101 prologue.truncated malformed 6.1
102 prologue.signature malformed 6.1
103 prologue.crc malformed 6.1
104 prologue.version unsupported 6.1
105 prologue.header_length malformed 6.1
201 header.truncated malformed 6.2
202 header.crc malformed 6.2
203 header.syntax malformed 6.2
204 header.reserved unsupported 6.2
205 header.profile unsupported 11.1
206 header.level unsupported 11.2
207 header.dimension invalid 11.1
208 header.anchor_count invalid 11.2
209 header.level_not_minimal invalid 11.2
210 header.chunk_size invalid 11.1
211 header.lanes invalid 6.2
212 header.base_step invalid 6.2
213 header.position_grid invalid 6.4
214 header.render_info invalid 6.5
215 header.work invalid 11.2
216 header.padding malformed 6.2
217 header.chunk_count invalid 6.2
301 directory.type malformed 6.6
302 directory.unknown_critical unsupported 6.6
303 directory.order malformed 6.6
304 directory.mode unsupported 6.6
305 directory.length malformed 6.6
311 section.truncated malformed 6.6
312 section.crc malformed 6.6
313 section.padding malformed 6.6
321 file.trailing malformed 6.6
401 frame.range invalid 6.7
402 frame.reserved unsupported 6.7
411 weights.scale invalid 6.8
412 weights.not_finite invalid 6.8
413 weights.bound invalid 6.8
414 weights.length malformed 6.8
415 weights.layer invalid 6.8
416 weights.exponent invalid 6.8
417 weights.padding malformed 6.8
418 weights.reserved unsupported 6.8
421 planes.length malformed 6.9
422 planes.padding malformed 6.9
431 index.mask_model invalid 6.10
432 index.position_model invalid 6.10
433 index.chunk invalid 6.10
434 index.length malformed 6.10
435 index.padding malformed 6.10
436 index.reserved unsupported 6.10
441 chunk.crc malformed 6.11
442 chunk.length malformed 6.11
443 chunk.form malformed 6.11
444 chunk.padding malformed 6.11
445 chunk.reserved unsupported 6.11
446 chunk.kept invalid 6.11
447 chunk.bounds invalid 6.11
451 positions.not_finite invalid 6.11
452 positions.negative_zero invalid 6.11
453 positions.count invalid 6.11
454 positions.cell invalid 6.11
501 substream.length malformed 8.1
502 substream.state invalid 8.1
503 substream.words invalid 8.8
504 substream.final_state invalid 8.8
505 substream.escape invalid 8.7
506 substream.symbol_range invalid 8.5
507 substream.raw_length invalid 8.8
508 substream.raw_padding invalid 8.8
509 substream.symbol_crc invalid 8.8
`;

// The rows by name, and their names by code.
export const REGISTRY = new Map();
const NAMES = new Map();
for (const row of ROWS.trim().split("\n")) {
  const [code, name, kind, clause] = row.split(" ");
  REGISTRY.set(name, { code: Number(code), name, class: kind, clause });
  NAMES.set(Number(code), name);
}

// Thrown for a rejected file.
export class C3gsError extends Error {
  // name: from the registry. offset: a byte of the file.
  constructor(name, offset) {
    const row = REGISTRY.get(name);
    super(`${row.class} at byte ${offset}; error ${row.code}, SPEC.md ${row.clause}`);
    Object.assign(this, row, { offset });
  }

  // The report of a program (conformance/README.md) for a rejected file.
  toJSON() {
    return { code: this.code, name: this.name, class: this.class, clause: this.clause, offset: this.offset };
  }
}

// Thrown for a file that needs more than its caller allows. It is not a verdict on the file.
export class BoundPassedError extends Error {
  // bound: "anchors" or "memory". needed, allowed: anchors, or bytes.
  constructor(bound, needed, allowed) {
    super(`${needed} ${bound === "memory" ? "bytes of memory" : "anchors"} are needed, and ${allowed} are allowed`);
    Object.assign(this, { name: "BoundPassedError", bound, needed, allowed });
  }
}

// Thrown for a scene of another render model. It is not a verdict on the file.
export class RenderModelError extends Error {
  constructor(model, why = "this version draws only 0 and 1; use a later version") {
    super(`render_model is ${model}, but ${why} (SPEC.md 6.5)`);
    this.name = "RenderModelError";
  }
}

export function need(condition, name, offset) {
  if (!condition) throw new C3gsError(name, offset);
}

export function errorOfCode(code, offset) {
  return new C3gsError(NAMES.get(code), offset);
}
