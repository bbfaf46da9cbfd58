// What this device can read of a photograph's file: pictures of 8 bits, as the sensor delivered them.

// A bitmap of the pixels as stored, notes about it, and whether its colours are of fewer pixels; null where the computer has
// to read the file: RAW, TIFF, 16 bits.
export async function readPicture(file) {
  const head = new Uint8Array(await file.slice(0, 2 ** 18).arrayBuffer());
  const isPng = head[0] === 0x89 && head[1] === 0x50, isJpeg = head[0] === 0xff && head[1] === 0xd8, isWebp = head[0] === 0x52 && head[8] === 0x57;
  if (!(isJpeg || isWebp || (isPng && head[24] === 8))) return null;
  const known = isJpeg ? readJpeg(head) : { notes: [], isHalved: false };  // takes the orientation out of `head`
  const stored = new Blob([head, file.slice(head.length)], { type: file.type });
  try {
    return { bitmap: await createImageBitmap(stored, { colorSpaceConversion: "none", premultiplyAlpha: "none" }), ...known };
  } catch {
    return null;  // damaged: the computer says so
  }
}

// Sentences about a JPEG: halved colours, and a photograph that does not stand upright. Browsers turn pictures as the
// tag says whatever they are asked, and the filters in the pupil do not turn with them: the tag is set to upright.
function readJpeg(data) {
  const view = new DataView(data.buffer), notes = [];
  let isHalved = false;
  for (let at = 2; at + 4 < data.length && data[at] === 0xff;) {
    const kind = data[at + 1], length = view.getUint16(at + 2);
    if (kind === 0xe1 && straighten(view, at + 4, at + 2 + length)) notes.push("a photograph in portrait orientation, or upside down: the maps stay as the sensor delivers them, like the calibration");
    if (kind >= 0xc0 && kind <= 0xc2) {
      const [across, down] = [data[at + 11] >> 4, data[at + 11] & 15];  // samples of luminance for one of colour
      isHalved = across * down > 1;
      if (isHalved) notes.push(`a JPEG with ${across > 1 && down > 1 ? "4:2:0" : "4:2:2"} chroma, which halves the resolution of the colours the depth is read from: measured here at half size, approximate, because a browser blurs them; the computer reads them as they are stored. Use RAW, PNG or TIFF, or JPEG at best quality (4:4:4)`);
      break;
    }
    at += 2 + length;
  }
  return { notes, isHalved };
}

// Sets the tag Orientation of an APP1 segment to upright; whether it was another.
function straighten(view, start, end) {
  try {
    if (view.getUint32(start) !== 0x45786966) return false;  // "Exif"
    const tiff = start + 6, little = view.getUint16(tiff) === 0x4949, first = tiff + view.getUint32(tiff + 4, little);
    for (let i = 0, at = first + 2, count = view.getUint16(first, little); i < count && at + 12 <= end; i++, at += 12) {
      if (view.getUint16(at, little) !== 0x0112) continue;
      const isTurned = view.getUint16(at + 8, little) > 1;
      view.setUint16(at + 8, 1, little);
      return isTurned;
    }
  } catch { /* cut off or damaged */ }
  return false;
}
