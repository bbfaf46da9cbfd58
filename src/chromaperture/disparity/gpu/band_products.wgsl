// Products of P and Q, halved by the filter 1 4 6 4 1 along both axes (OpenCV's pyrDown): every second sample.

@group(0) @binding(0) var<storage, read> band_views: array<vec2f>;  // (planes, h, w)
@group(0) @binding(1) var<storage, read_write> products: array<f32>;  // (planes, ceil(h / 2), ceil(w / 2), 3)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let small_width = (width + 1u) / 2u;
    let small_height = (height + 1u) / 2u;
    if (i >= planes * small_width * small_height) { return; }
    let x = i % small_width;
    let y = i / small_width % small_height;
    let plane = i / (small_width * small_height) * width * height;
    let taps = array<f32, 5>(0.0625, 0.25, 0.375, 0.25, 0.0625);
    var sum = vec3f();
    for (var j = 0u; j < 5u; j++) {
        let row = plane + mirrored(i32(2u * y + j) - 2i, height) * width;
        var along = vec3f();
        for (var k = 0u; k < 5u; k++) {
            let here = band_views[row + mirrored(i32(2u * x + k) - 2i, width)];
            along += taps[k] * vec3f(here.x * here.y, here * here);
        }
        sum += taps[j] * along;
    }
    products[3u * i] = sum.x;
    products[3u * i + 1u] = sum.y;
    products[3u * i + 2u] = sum.z;
}
