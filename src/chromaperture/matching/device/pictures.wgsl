// Counts to light, and maps to pictures, for a browser.

// ---- light_of_counts: indexing, shared
// A picture of 8 bits to linear light, by a table. Squares of pixels are averaged, as `working_scale.reduced` does: of a
// square with a saturated pixel the mean is not known, and it counts as saturated.

in counts: array<u32>;  // rows of R, G, B, A, a byte each
in form: array<u32>;  // pixels along a square's side, pixels from row to row
in light: array<f32>;  // of the 256 counts
out image: array<f32>;  // (H, W, 3)

fn main(i) {
    if (i >= width * height) { return; }
    let side = form[0];
    let first = i / width * side * form[1] + i % width * side;
    var sum = vec3f();
    var most = 0.0;
    for (var v = 0u; v < side; v++) {
        for (var u = 0u; u < side; u++) {
            let packed = counts[first + v * form[1] + u];
            let rgb = vec3f(light[packed & 255u], light[(packed >> 8u) & 255u], light[(packed >> 16u) & 255u]);
            sum += rgb;
            most = max(most, max(max(rgb.x, rgb.y), rgb.z));
        }
    }
    let mean = select(sum / f32(side * side), vec3f(1.0), most >= saturation);
    for (var c = 0u; c < 3u; c++) { image[3u * i + c] = mean[c]; }
}

// ---- aligned_light
// Light of the channels where they were displaced to, white balanced; of pixels of unknown disparity as it was captured.
// For the eye: linear between pixels, and what another surface hides is not filled in.

fn channel(c: u32, x: f32, y: f32) -> f32 {
    let left = floor(x);
    let top = floor(y);
    let columns = vec2u(inside(i32(left), width), inside(i32(left) + 1i, width));
    let rows = vec2u(inside(i32(top), height), inside(i32(top) + 1i, height)) * width;
    let above = mix(image[3u * (rows.x + columns.x) + c], image[3u * (rows.x + columns.y) + c], x - left);
    let below = mix(image[3u * (rows.y + columns.x) + c], image[3u * (rows.y + columns.y) + c], x - left);
    return mix(above, below, y - top);
}

fn aligned(i: u32) -> vec3f {
    let known = disparity[i] != NAN_BITS;
    let d = select(0.0, bitcast<f32>(disparity[i]), known);
    var rgb = vec3f();
    for (var c = 0u; c < 3u; c++) {
        rgb[c] = balance[c] * channel(c, f32(i % width) + d * shifts[2u * c], f32(i / width) + d * shifts[2u * c + 1u]);
    }
    return rgb;
}

// ---- sparse_maps: indexing, shared, aligned_light
// Every so many pixels of the maps and of the picture: what the ranges of colours are found from.

in image: array<f32>;  // (H, W, 3)
in disparity: array<u32>;  // (H, W)
in depth: array<u32>;  // (H, W)
in sigma: array<u32>;  // (H, W)
out sparse: array<u32>;  // (3, h, w): depth, error bar, brightest channel

fn main(i) {
    let count = sparse_width * sparse_height;
    if (i >= count) { return; }
    let from_pixel = i / sparse_width * step * width + i % sparse_width * step;
    let rgb = aligned(from_pixel);
    sparse[i] = depth[from_pixel];
    sparse[count + i] = sigma[from_pixel];
    sparse[2u * count + i] = bitcast<u32>(max(max(rgb.x, rgb.y), rgb.z));
}

// ---- colored_maps: indexing, shared, aligned_light
// Depth, its error bar, or the aligned colours as a picture of 8 bits.

in image: array<f32>;  // (H, W, 3)
in disparity: array<u32>;  // (H, W)
in depth: array<u32>;  // (H, W)
in sigma: array<u32>;  // (H, W)
in colors: array<u32>;  // (2, 257): of depth and error bar, the last unknown
in look: array<f32>;  // view (0 depth, 1 error bar, 2 colours), low, high, white
out picture: array<u32>;  // (H, pitch): R, G, B, A, a byte each

// As `color_maps.draw_levels`.
fn level(value: u32) -> u32 {
    if (value == NAN_BITS) { return 256u; }
    let share = (bitcast<f32>(value) - look[1]) / (look[2] - look[1]);
    return u32(clamp(share * 256.0, 0.0, 255.0));
}

// A quarter of one color, three of the other.
fn mixed(one: u32, other: u32) -> u32 {
    var found = 0xff000000u;
    for (var bit = 0u; bit < 24u; bit += 8u) {
        found |= ((((one >> bit) & 255u) + 3u * ((other >> bit) & 255u)) >> 2u) << bit;
    }
    return found;
}

// IEC 61966-2-1.
fn encoded(light: f32) -> u32 {
    let value = clamp(light, 0.0, 1.0);
    let srgb = select(1.055 * pow(max(value, 1.0e-6), 1.0 / 2.4) - 0.055, 12.92 * value, value <= 0.0031308);
    return u32(round(255.0 * srgb));
}

fn main(i) {
    if (i >= width * height) { return; }
    let at = i / width * pitch + i % width;
    if (look[0] == 0.0) {
        let color = colors[level(depth[i])];
        let known = depth[i] != NAN_BITS && sigma[i] != NAN_BITS;
        let dark = is_depth && known && bitcast<f32>(sigma[i]) > most_relative * bitcast<f32>(depth[i]);
        picture[at] = select(color, mixed(color, colors[256]), dark);
    } else if (look[0] == 1.0) {
        picture[at] = colors[257u + level(sigma[i])];
    } else {
        let rgb = aligned(i) / look[3];
        picture[at] = encoded(rgb.x) | (encoded(rgb.y) << 8u) | (encoded(rgb.z) << 16u) | 0xff000000u;
    }
}
