// Focal lengths of both cameras over time, with a band of one sigma.
import { color, prepared } from "./drawing.js";

const LEFT = 46, RIGHT = 8, TOP = 8, BOTTOM = 22;
const EYES = [["estimate", 1], ["assistant", 3]];

export function drawFocal(canvas, kit) {
  const { pen, width, height } = prepared(canvas);
  const rows = kit.history.filter((row) => row[0] !== null);
  if (!rows.length) return;
  const seconds = Math.max(rows[rows.length - 1][0], 1);
  const [low, high] = limits(rows);
  const x = (t) => LEFT + t / seconds * (width - LEFT - RIGHT);
  const y = (f) => TOP + (high - f) / (high - low) * (height - TOP - BOTTOM);
  pen.strokeStyle = color("line");
  pen.fillStyle = color("muted");
  pen.textAlign = "right";
  for (const share of [0.1, 0.5, 0.9]) {
    const f = low + share * (high - low);
    pen.beginPath();
    pen.moveTo(LEFT, y(f));
    pen.lineTo(width - RIGHT, y(f));
    pen.stroke();
    pen.fillText(`${Math.round(f)} px`, LEFT - 5, y(f) + 4);
  }
  pen.fillText(`${Math.round(seconds)} s`, width - RIGHT, height - 5);
  pen.save();
  pen.beginPath();
  pen.rect(LEFT, TOP, width - LEFT - RIGHT, height - TOP - BOTTOM);
  pen.clip();
  for (const [name, column] of EYES) {
    const known = rows.filter((row) => row[column] !== null);
    if (!known.length) continue;
    drawBand(pen, known.filter((row) => row[column + 1] !== null), column, x, y, color(name));
    pen.strokeStyle = pen.fillStyle = color(name);
    pen.lineWidth = 2;
    pen.beginPath();
    known.forEach((row, i) => pen[i ? "lineTo" : "moveTo"](x(row[0]), y(row[column])));
    pen.stroke();
    const last = known[known.length - 1];
    pen.beginPath();
    pen.arc(x(last[0]), y(last[column]), 3, 0, 2 * Math.PI);
    pen.fill();
  }
  pen.restore();
}

function drawBand(pen, rows, column, x, y, shade) {
  const edge = (row, side) =>
    [x(row[0]), y(row[column] * Math.exp(side * row[column + 1] / 100))];
  pen.fillStyle = shade;
  pen.globalAlpha = 0.18;
  pen.beginPath();
  rows.forEach((row, i) => pen[i ? "lineTo" : "moveTo"](...edge(row, 1)));
  rows.slice().reverse().forEach((row) => pen.lineTo(...edge(row, -1)));
  pen.closePath();
  pen.fill();
  pen.globalAlpha = 1;
}

// of the estimates and the newest sigmas: those at the beginning may be larger than any scale
function limits(rows) {
  const values = [];
  for (const [, column] of EYES) {
    for (const row of rows) if (row[column] !== null) values.push(row[column]);
    const last = rows[rows.length - 1], sigma = Math.min(last[column + 1] ?? 0, 30) / 100;
    if (last[column] !== null) {
      values.push(last[column] * Math.exp(1.5 * sigma), last[column] * Math.exp(-1.5 * sigma));
    }
  }
  const low = Math.min(...values), high = Math.max(...values);
  const edge = Math.max(0.12 * (high - low), 0.005 * high);
  return [low - edge, high + edge];
}
