// A strip chart of the last seconds: curves with axes and units, on a canvas.
const SECONDS = 8;
const CURVES = [['against', '#b4632a', 0], ['up', '#33658a', 1], ['across', '#7a8b4f', 2]];
const BOUNDED = CURVES.slice(0, 2);  // that have a band

function niceStep(span, lines) {
  const raw = Math.max(span, 1e-9) / lines, ten = 10 ** Math.floor(Math.log10(raw));
  return ten * [1, 2, 5, 10].find((k) => k * ten >= raw);
}

// Lowest and highest value that the axis shows, and the step of its lines: of forces and bands.
function plotRange(rows) {
  let low = 0, high = 20;
  for (const r of rows) {
    const values = [...r.force, ...(r.ghost || [])];
    if (isFinite(r.bound)) for (const [, , k] of BOUNDED) values.push(r.force[k] - r.bound, r.force[k] + r.bound);
    low = Math.min(low, ...values); high = Math.max(high, ...values);
  }
  const step = niceStep(high - low, 4);
  return [step * Math.floor(low / step), step * Math.ceil(high / step), step];
}

// Rows: {t, force [3], bound, ghost [3] or null}; unit N.
function drawPlot(canvas, rows) {
  const ratio = Math.min(devicePixelRatio || 1, 2), w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width !== Math.round(w * ratio)) canvas.width = Math.round(w * ratio);
  if (canvas.height !== Math.round(h * ratio)) canvas.height = Math.round(h * ratio);
  const c = canvas.getContext('2d'), left = 44, top = 16, right = w - 4, bottom = h - 30;
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.clearRect(0, 0, w, h);
  c.font = '11px system-ui, sans-serif';
  const end = Math.max(SECONDS, rows.length ? rows[rows.length - 1].t : 0), begin = end - SECONDS;
  const [low, high, step] = plotRange(rows);
  const x = (t) => left + (t - begin) / SECONDS * (right - left);
  const y = (f) => bottom - (f - low) / (high - low) * (bottom - top);
  c.lineWidth = 1; c.fillStyle = '#857d72'; c.textAlign = 'right'; c.textBaseline = 'middle';
  for (let f = low; f <= high + step / 2; f += step) {
    c.strokeStyle = Math.abs(f) < step / 2 ? '#bdb3a4' : '#ece6dc';
    c.beginPath(); c.moveTo(left, y(f)); c.lineTo(right, y(f)); c.stroke();
    c.fillText(String(Math.round(f)), left - 6, y(f));
  }
  c.textAlign = 'center'; c.textBaseline = 'top';
  for (let t = Math.ceil(begin / 2) * 2; t <= end; t += 2) c.fillText(String(t), x(t), bottom + 4);
  c.textAlign = 'right'; c.fillText('time, s', right, bottom + 17);
  c.textAlign = 'left'; c.fillText('force, N', 0, 0);
  c.save(); c.beginPath(); c.rect(left, top - 4, right - left, bottom - top + 8); c.clip();
  const curve = (value, colour, dash, width) => {
    c.strokeStyle = colour; c.lineWidth = width; c.setLineDash(dash); c.beginPath();
    let down = false;
    for (const r of rows) {
      const v = value(r);
      if (v === null || !isFinite(v)) { down = false; continue; }
      if (down) c.lineTo(x(r.t), y(v)); else c.moveTo(x(r.t), y(v));
      down = true;
    }
    c.stroke(); c.setLineDash([]);
  };
  if (rows.some((r) => isFinite(r.bound))) {
    for (const [, colour, k] of BOUNDED) {
      c.fillStyle = colour + '22'; c.beginPath();
      const known = rows.filter((r) => isFinite(r.bound));
      for (const r of known) c.lineTo(x(r.t), y(r.force[k] + r.bound));
      for (const r of known.reverse()) c.lineTo(x(r.t), y(r.force[k] - r.bound));
      c.fill();
    }
  }
  for (const [, colour, k] of CURVES) {
    curve((r) => (r.ghost ? r.ghost[k] : null), colour, [4, 3], 1.3);
    curve((r) => r.force[k], colour, [], 1.8);
  }
  c.restore();
}
