"use strict";
// Decoding of a picture: "RIG1", length of a JSON header, the header, float32 columns. See live/frames.py.
const decodePicture = (buffer) => {
  const view = new DataView(buffer);
  if (buffer.byteLength < 8 || view.getUint32(0, false) !== 0x52494731) throw new Error("expected a picture of the rig");
  const length = view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  const columns = {};
  let place = 8 + length;
  for (const [name, size] of Object.entries(header.columns)) {
    columns[name] = new Float32Array(buffer, place, size);
    place += 4 * size;
  }
  return { header, columns };
};
