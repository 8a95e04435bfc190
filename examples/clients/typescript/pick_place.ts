// Plans a pick-and-place over HTTP, and prints what a controller has to do, one JSON object on each line.
//
//   node build/pick_place.js http://localhost:8080 [TOKEN]
//
// Lines are {"plan": ID}, then for each motion {"motion": NAME}, {"gripper": METRES} if the gripper moves before it, and
// {"t": SECONDS, "q": [...], "qd": [...], "qdd": [...]} every 2 ms: be at q, in rad, at t since the motion began.

import createClient from "openapi-fetch";
import type { components, paths } from "./schema.js";

type Task = components["schemas"]["TaskRecord"];
type Sampled = components["schemas"]["SampledReply"];
type Motion = components["schemas"]["MotionSamples"];

const TICK = 0.002; // seconds between two commands to the arm

const [url = "http://localhost:8080", token] = process.argv.slice(2);
const headers: Record<string, string> = token === undefined ? {} : { Authorization: `Bearer ${token}` };
const server = createClient<paths>({ baseUrl: url, headers });

const { id, task } = await plan();
if (task.failure) throw new Error(`no plan: ${task.failure.detail}`);
print({ plan: id });
const sampled = await trajectory(id);
for (const motion of sampled.motions) {
  print({ motion: motion.name });
  for (const event of sampled.events) {
    if (event.before === motion.name && event.width != null) print({ gripper: event.width });
  }
  for (let tick = 0; tick * TICK < motion.duration; tick++) print(at(motion, tick * TICK));
  print(at(motion, motion.duration));
}

/** The task, proven, and its id. The answer leaves the robot out: it is that of GET /robot. */
async function plan(): Promise<{ id: string; task: Task }> {
  const { data, error, response } = await server.POST("/pick_place", {
    params: { header: { Prefer: "wait" }, query: { robot: "hash" } },
    body: { scene: "bin", target: "blue_block", onto: "tray", request: { padding: 0.005 } },
  });
  if (error) throw new Error(error.detail);
  const place = response.headers.get("Content-Location");
  if (place === null || !("segments" in data)) throw new Error("it takes longer than a minute");
  return { id: place.replace("/plans/", ""), task: data };
}

/** Its motions every 10 ms. */
async function trajectory(plan: string): Promise<Sampled> {
  const { data, error } = await server.GET("/plans/{plan}/trajectory", {
    params: { path: { plan }, query: { format: "json", dt: 0.01 } },
  });
  if (error) throw new Error(error.detail);
  if (typeof data !== "object" || !("deviation" in data)) throw new Error("not in the format json");
  return data;
}

/** Where a motion is at t: on the quintic through positions, velocities and accelerations of two samples. */
function at(motion: Motion, t: number): { t: number; q: number[]; qd: number[]; qdd: number[] } {
  const after = motion.t.findIndex((time) => time >= t);
  const k = Math.max(after < 0 ? motion.t.length - 1 : after, 1) - 1;
  const [begin, end] = [motion.t[k], motion.t[k + 1]];
  if (begin === undefined || end === undefined) {
    return { t, q: row(motion.positions, 0), qd: row(motion.velocities, 0), qdd: row(motion.accelerations, 0) };
  }
  const [h, x] = [end - begin, (t - begin) / (end - begin)];
  const joints = row(motion.positions, k).map((_, joint) => {
    const value = (rows: number[][], sample: number): number => row(rows, sample)[joint] ?? NaN;
    const [q0, q1] = [value(motion.positions, k), value(motion.positions, k + 1)];
    const [v0, v1] = [value(motion.velocities, k) * h, value(motion.velocities, k + 1) * h];
    const [a0, a1] = [value(motion.accelerations, k) * h * h, value(motion.accelerations, k + 1) * h * h];
    const c3 = 10 * (q1 - q0) - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1;
    const c4 = -15 * (q1 - q0) + 8 * v0 + 7 * v1 + 1.5 * a0 - a1;
    const c5 = 6 * (q1 - q0) - 3 * (v0 + v1) - 0.5 * (a0 - a1);
    return {
      q: q0 + x * (v0 + x * (a0 / 2 + x * (c3 + x * (c4 + x * c5)))),
      qd: (v0 + x * (a0 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))) / h,
      qdd: (a0 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5))) / (h * h),
    };
  });
  return { t, q: joints.map((each) => each.q), qd: joints.map((each) => each.qd), qdd: joints.map((each) => each.qdd) };
}

function row(rows: number[][], k: number): number[] {
  const found = rows[k];
  if (found === undefined) throw new Error(`no sample ${k}`);
  return found;
}

function print(line: object): void {
  process.stdout.write(`${JSON.stringify(line)}\n`);
}
