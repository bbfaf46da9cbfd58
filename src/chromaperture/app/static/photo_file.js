// What this device can read of a photograph's file: pictures of 8 bits, as the sensor delivered them.

// A bitmap of the pixels as stored, or null where the computer has to read the file: RAW, TIFF, 16 bits.
export async function readPicture(file) {
  const head = new Uint8Array(await file.slice(0, 2 ** 18).arrayBuffer());
  const isPng = head[0] === 0x89 && head[1] === 0x50, isJpeg = head[0] === 0xff && head[1] === 0xd8, isWebp = head[0] === 0x52 && head[8] === 0x57;
  if (!(isJpeg || isWebp || (isPng && head[24] === 8))) return null;
  let bitmap;
  try {
    bitmap = await createImageBitmap(file, { imageOrientation: "none", colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch {
    return null;  // damaged: the computer says so
  }
  return { bitmap, notes: isJpeg ? jpegNotes(head) : [] };
}

// Sentences about a JPEG: halved colours, and a photograph that does not stand upright.
function jpegNotes(data) {
  const view = new DataView(data.buffer), notes = [];
  for (let at = 2; at + 4 < data.length && data[at] === 0xff;) {
    const kind = data[at + 1], length = view.getUint16(at + 2);
    if (kind === 0xe1 && exifOrientation(view, at + 4, at + 2 + length) > 1) notes.push("a photograph in portrait orientation, or upside down: the maps stay as the sensor delivers them, like the calibration");
    if (kind >= 0xc0 && kind <= 0xc2) {
      const [across, down] = [data[at + 11] >> 4, data[at + 11] & 15];  // samples of luminance for one of colour
      if (across * down > 1) notes.push(`a JPEG with ${across > 1 && down > 1 ? "4:2:0" : "4:2:2"} chroma, which halves the resolution of the colours the depth is read from; use RAW, PNG or TIFF, or JPEG at best quality (4:4:4)`);
      break;
    }
    at += 2 + length;
  }
  return notes;
}

// The tag Orientation of an APP1 segment; 1 is upright.
function exifOrientation(view, start, end) {
  try {
    if (view.getUint32(start) !== 0x45786966) return 1;  // "Exif"
    const tiff = start + 6, little = view.getUint16(tiff) === 0x4949, first = tiff + view.getUint32(tiff + 4, little);
    for (let i = 0, count = view.getUint16(first, little); i < count && first + 14 + 12 * i <= end; i++)
      if (view.getUint16(first + 2 + 12 * i, little) === 0x0112) return view.getUint16(first + 10 + 12 * i, little);
  } catch { /* cut off or damaged */ }
  return 1;
}
