// What several stages use: places in `stats`, coordinates inside the picture, unknown values.

const UNKNOWN = 3.0e38f;  // stands for NaN on the device, where arithmetic may assume that there is none
const NAN_BITS = 0x7fc00000u;

// Places in `stats`, the numbers of one picture that later stages need.
const MEAN_RED = 0u;  // of the usable pixels; green and blue follow
const MEAN_ALL = 3u;  // of all their channels
const USABLE = 4u;  // pixels
const UNUSABLE = 5u;
const UNIT = 6u;  // of light, a power of two; its inverse follows
const VARIANCE = 8u;  // of each view
const GUIDE_SCALE = 12u;  // to units of guide_range: of the matched guide, then of the full one

fn inside(at: i32, count: u32) -> u32 {
    return u32(clamp(at, 0i, i32(count) - 1i));
}

fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

fn is_known(value: f32) -> bool {
    return value < 1.0e38f;
}
