// A picture of 8 bits to linear light, by a table. Squares of pixels are averaged, as `working_scale.reduced` does: of a
// square with a saturated pixel the mean is not known, and it counts as saturated.

@group(0) @binding(0) var<storage, read> counts: array<u32>;  // rows of R, G, B, A, a byte each
@group(0) @binding(1) var<storage, read> form: array<u32>;  // pixels along a square's side, pixels from row to row
@group(0) @binding(2) var<storage, read> light: array<f32>;  // of the 256 counts
@group(0) @binding(3) var<storage, read_write> image: array<f32>;  // (H, W, 3)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
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
