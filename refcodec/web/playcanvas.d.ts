// Files `.c3gs` as assets of the type `gsplat` of `playcanvas` 2:
// `app.loader.getHandler("gsplat")?.addParser(new C3gsParser(app))`
import { AppBase, Entity } from "playcanvas";
import { Options } from "./c3gs.js";

/** Turns an entity upright whose gsplat component has a file, and adds and returns a camera with its default view. */
export function place(entity: Entity): Entity;

/**
 * The Gaussians of a static scene are those for all cameras, and else those that the first camera of the file sees.
 * They are `gaussians` of the resource. The errors of `decode` and of `Gaussians` reach the asset.
 */
export class C3gsParser {
  /** options: of `decode` and of `Gaussians`. */
  constructor(app: AppBase, options?: Options);
  canParse(context: { ext: string }): boolean;
  load(url: string | { load: string }, callback: (error: any, resource?: any) => void, asset?: any): void;
}
