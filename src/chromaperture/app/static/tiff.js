// A map as a TIFF file of 32-bit floats, NaN unknown, as `depth` writes it: one strip, not compressed.
export function floatTiff(values, width, height) {
  const tags = [[256, 4, width], [257, 4, height], [258, 3, 32], [259, 3, 1], [262, 3, 1], [273, 4, 0], [277, 3, 1], [278, 4, height], [279, 4, 4 * values.length], [339, 3, 3]];
  const start = 8 + 2 + 12 * tags.length + 4, view = new DataView(new ArrayBuffer(start));
  view.setUint32(0, 0x49492a00);
  view.setUint32(4, 8, true);
  view.setUint16(8, tags.length, true);
  for (const [i, [tag, kind, value]] of tags.entries()) {
    const at = 10 + 12 * i;
    view.setUint16(at, tag, true);
    view.setUint16(at + 2, kind, true);
    view.setUint32(at + 4, 1, true);
    view.setUint32(at + 8, tag === 273 ? start : value, true);  // a short lies in the first two bytes
  }
  return new Blob([view.buffer, values], { type: "image/tiff" });
}
