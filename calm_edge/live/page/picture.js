// A camera's picture with its tracks and what the mask leaves out.
const TRACK = "#35e0a1", POINT = "#ffd34d", MASK = "rgba(229,57,53,.38)";
// a track is drawn some times as long as it is from one frame to the next
const LONGER = 3;
const loading = new WeakMap();

export function drawPicture(canvas, picture, mask) {
  const image = new Image();
  loading.set(canvas, image);
  image.onload = () => {
    // a newer one may have overtaken it
    if (loading.get(canvas) !== image) return;
    canvas.width = image.naturalWidth;
    canvas.height = image.naturalHeight;
    const pen = canvas.getContext("2d");
    pen.drawImage(image, 0, 0);
    if (mask) drawMask(pen, mask, canvas.width, canvas.height);
    const scale = canvas.width / picture.width;
    drawTracks(pen, picture.moves || [], scale);
    pen.fillStyle = POINT;
    for (const [u, v] of picture.points || []) {
      pen.beginPath();
      pen.arc((u + 0.5) * scale, (v + 0.5) * scale, 2.2, 0, 2 * Math.PI);
      pen.fill();
    }
  };
  image.src = picture.src;
}

function drawTracks(pen, moves, scale) {
  pen.strokeStyle = pen.fillStyle = TRACK;
  pen.lineWidth = 1.3;
  for (const [u, v, u0, v0] of moves) {
    const x = (u + 0.5) * scale, y = (v + 0.5) * scale;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(x - LONGER * (u - u0) * scale, y - LONGER * (v - v0) * scale);
    pen.stroke();
    pen.fillRect(x - 1.5, y - 1.5, 3, 3);
  }
}

function drawMask(pen, mask, width, height) {
  const bits = Uint8Array.from(atob(mask.bits), (c) => c.charCodeAt(0));
  const stride = Math.ceil(mask.width / 8);
  const w = width / mask.width, h = height / mask.height;
  pen.fillStyle = MASK;
  for (let i = 0; i < mask.height; i++) {
    for (let j = 0; j < mask.width; j++) {
      if (bits[i * stride + (j >> 3)] & (0x80 >> (j & 7))) pen.fillRect(j * w, i * h, w, h);
    }
  }
}
