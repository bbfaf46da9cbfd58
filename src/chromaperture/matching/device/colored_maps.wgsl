// Depth, its error bar, or the aligned colours as a picture of 8 bits.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read> disparity: array<u32>;  // (H, W)
@group(0) @binding(2) var<storage, read> depth: array<u32>;  // (H, W)
@group(0) @binding(3) var<storage, read> sigma: array<u32>;  // (H, W)
@group(0) @binding(4) var<storage, read> colors: array<u32>;  // (2, 257): of depth and error bar, the last unknown
@group(0) @binding(5) var<storage, read> look: array<f32>;  // view (0 depth, 1 error bar, 2 colours), low, high, white
@group(0) @binding(6) var<storage, read_write> picture: array<u32>;  // (H, pitch): R, G, B, A, a byte each

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

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
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
