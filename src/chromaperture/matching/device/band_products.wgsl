// Products of P and Q, halved by the filter 1 4 6 4 1 along both axes (OpenCV's pyrDown): every second sample. An
// invocation has four samples below each other, whose windows overlap.

@group(0) @binding(0) var<storage, read> band_views: array<vec2f>;  // (planes, h, w)
@group(0) @binding(1) var<storage, read_write> products: array<f32>;  // (planes, ceil(h / 2), ceil(w / 2), 3)

const small_width = (width + 1u) / 2u;
const small_height = (height + 1u) / 2u;
const fours = (small_height + 3u) / 4u;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= planes * small_width * fours) { return; }
    let x = i % small_width;
    let y = 4u * (i / small_width % fours);
    let plane = i / (small_width * fours);
    let taps = vec3f(0.0625, 0.25, 0.375);
    var sums: array<vec3f, 4>;
    for (var j = 0u; j < 11u; j++) {
        let row = (plane * height + mirrored(i32(2u * y + j) - 2i, height)) * width;
        var along = vec3f();
        for (var k = 0u; k < 5u; k++) {
            let here = band_views[row + mirrored(i32(2u * x + k) - 2i, width)];
            along += taps[min(k, 4u - k)] * vec3f(here.x * here.y, here * here);
        }
        for (var n = 0u; n < 4u; n++) {
            if (j >= 2u * n && j <= 2u * n + 4u) { sums[n] += taps[min(j - 2u * n, 2u * n + 4u - j)] * along; }
        }
    }
    for (var n = 0u; n < min(4u, small_height - y); n++) {
        let to = 3u * ((plane * small_height + y + n) * small_width + x);
        products[to] = sums[n].x;
        products[to + 1u] = sums[n].y;
        products[to + 2u] = sums[n].z;
    }
}
