// Samples that are occluded in a channel, predicted from the colour line of their own surface (`color/visibility.py`,
// fill_hidden), and all samples white balanced.

@group(0) @binding(0) var<storage, read> shifted: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read> visible: array<u32>;  // (H, W): a bit a channel
@group(0) @binding(2) var<storage, read> filled: array<f32>;  // (H, W): disparity
@group(0) @binding(3) var<storage, read_write> color: array<u32>;  // (H, W, 3)

fn is_visible(i: u32, k: u32) -> bool {
    return (visible[i] & (1u << k)) != 0u;
}

// The best visible channel but k, 3 where there is none.
fn guide_of(i: u32, k: u32) -> u32 {
    for (var n = 0u; n < 3u; n++) {
        let candidate = u32(order[n]);
        if (candidate != k && is_visible(i, candidate)) { return candidate; }
    }
    return 3u;
}

fn predicted(i: u32, k: u32) -> f32 {
    let x = i32(i % width);
    let y = i32(i / width);
    let guide = guide_of(i, k);
    let guided = guide < 3u;
    var count = 0.0;
    var sums = vec2f();  // of the guide, of the channel
    var products = vec2f();  // of the guide with both
    for (var row = inside(y - i32(radius_px), height); row <= inside(y + i32(radius_px), height); row++) {
        for (var column = inside(x - i32(radius_px), width); column <= inside(x + i32(radius_px), width); column++) {
            let at = row * width + column;
            if (!is_visible(at, k) || abs(filled[at] - filled[i]) > same_surface_px) { continue; }
            if (guided && !is_visible(at, min(guide, 2u))) { continue; }
            let own = shifted[3u * at + k];
            let other = select(0.0, shifted[3u * at + min(guide, 2u)], guided);
            if (!is_known(own) || !is_known(other)) { return UNKNOWN; }
            sums += vec2f(other, own);
            products += other * vec2f(other, own);
            count += 1.0;
        }
    }
    if (count < fewest) { return shifted[3u * i + k]; }
    let mean = sums / count;
    let slope = (products.y / count - mean.x * mean.y) / (products.x / count - mean.x * mean.x + ridge);
    var apart = 0.0;
    if (guided) {
        let here = shifted[3u * i + min(guide, 2u)];
        if (!is_known(here)) { return UNKNOWN; }
        apart = here - mean.x;
    }
    return max(mean.y + slope * apart, 0.0);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    for (var k = 0u; k < 3u; k++) {
        var value = shifted[3u * i + k];
        if (!is_visible(i, k)) { value = predicted(i, k); }
        color[3u * i + k] = select(NAN_BITS, bitcast<u32>(max(value * gains[k], 0.0)), is_known(value));
    }
}
