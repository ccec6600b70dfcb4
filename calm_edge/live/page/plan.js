// The path from above: points of the newest sub-map, the path, the car, and a scale.
import { color, prepared, roundBelow } from "./drawing.js";

const EDGE = 18;

export function drawPlan(canvas, plan, pose, unit) {
  const { pen, width, height } = prepared(canvas);
  const here = pose && pose.x !== undefined ? [[pose.x, pose.y]] : [];
  const seen = plan.path.concat(here);
  if (!seen.length) {
    pen.fillStyle = color("muted");
    pen.fillText("the path appears with the first sub-map", EDGE, height / 2);
    return;
  }
  const frame = framed(seen, nearby(plan.points, seen), width, height);
  const pixel = ([x, y]) => [
    width / 2 + (x - frame.x) * frame.scale, height / 2 - (y - frame.y) * frame.scale];
  pen.fillStyle = color("points");
  for (const point of plan.points) {
    const [x, y] = pixel(point);
    pen.fillRect(x - 1, y - 1, 2, 2);
  }
  pen.strokeStyle = color("estimate");
  pen.lineWidth = 3;
  pen.beginPath();
  plan.path.forEach((point, i) => pen[i ? "lineTo" : "moveTo"](...pixel(point)));
  pen.stroke();
  if (plan.path.length) {
    const [x, y] = pixel(plan.path[0]);
    pen.fillStyle = color("card");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(x, y, 4, 0, 2 * Math.PI);
    pen.fill();
    pen.stroke();
  }
  if (here.length) drawCar(pen, pixel(here[0]), pose.heading_deg * Math.PI / 180);
  drawScale(pen, frame.scale, height, unit);
}

// points far from the path would make it tiny
function nearby(points, path) {
  const size = Math.max(10, span(path, 0), span(path, 1));
  const [x, y] = path[path.length - 1];
  return points.filter((p) => Math.hypot(p[0] - x, p[1] - y) < 0.6 * size);
}

function span(points, i) {
  const values = points.map((p) => p[i]);
  return Math.max(...values) - Math.min(...values);
}

function framed(path, points, width, height) {
  const all = path.concat(points), xs = all.map((p) => p[0]), ys = all.map((p) => p[1]);
  const [left, right] = [Math.min(...xs), Math.max(...xs)];
  const [low, high] = [Math.min(...ys), Math.max(...ys)];
  const scale = Math.min((width - 2 * EDGE) / Math.max(right - left, 2),
    (height - 2 * EDGE - 14) / Math.max(high - low, 2));
  return { x: (left + right) / 2, y: (low + high) / 2 - 7 / scale, scale };
}

function drawCar(pen, [x, y], heading) {
  pen.save();
  pen.translate(x, y);
  pen.rotate(heading);
  pen.fillStyle = color("assistant");
  pen.strokeStyle = color("card");
  pen.lineWidth = 1.5;
  pen.beginPath();
  pen.moveTo(0, -11);
  pen.lineTo(7, 8);
  pen.lineTo(0, 4);
  pen.lineTo(-7, 8);
  pen.closePath();
  pen.fill();
  pen.stroke();
  pen.restore();
}

function drawScale(pen, scale, height, unit) {
  const length = roundBelow(110 / scale), y = height - 8;
  pen.strokeStyle = pen.fillStyle = color("muted");
  pen.lineWidth = 1.5;
  pen.beginPath();
  pen.moveTo(EDGE, y - 4);
  pen.lineTo(EDGE, y);
  pen.lineTo(EDGE + length * scale, y);
  pen.lineTo(EDGE + length * scale, y - 4);
  pen.stroke();
  pen.fillText(`${length} ${unit}`, EDGE + 4, y - 5);
}
