// All Gaussians of the bands along the rows of P and Q. An invocation has four neighbours, whose pixels overlap.

@group(0) @binding(0) var<storage, read> joined: array<vec2f>;  // (pictures, h, w)
@group(0) @binding(1) var<storage, read> taps: array<f32>;  // (2 reach + 4, smooths): three zeros at the end
@group(0) @binding(2) var<storage, read_write> smooth_rows: array<vec2f>;  // (smooths, pictures, h, w)

const fours = (width + 3u) / 4u;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pictures * height * fours) { return; }
    let x = 4u * (i % fours);
    let row = i / fours * width;
    var weights: array<vec4f, smooths>;  // of the four pixels, for what is read
    var p: array<vec4f, smooths>;
    var q: array<vec4f, smooths>;
    for (var k = 0u; k < 2u * reach + 4u; k++) {
        let here = joined[row + mirrored(i32(x + k) - i32(reach), width)];
        for (var s = 0u; s < smooths; s++) {
            weights[s] = vec4f(taps[k * smooths + s], weights[s].xyz);
            p[s] += weights[s] * here.x;
            q[s] += weights[s] * here.y;
        }
    }
    for (var s = 0u; s < smooths; s++) {
        for (var n = 0u; n < min(4u, width - x); n++) {
            smooth_rows[s * pictures * height * width + row + x + n] = vec2f(p[s][n], q[s][n]);
        }
    }
}
