// All Gaussians of the bands along the columns, and their differences: the bands of P and Q. An invocation has four
// neighbours, whose pixels overlap. The finest Gaussian is that of P and Q themselves: number 0.

@group(0) @binding(0) var<storage, read> joined: array<vec2f>;  // (pictures, h, w)
@group(0) @binding(1) var<storage, read> smooth_rows: array<vec2f>;  // (smooths, pictures, h, w)
@group(0) @binding(2) var<storage, read> taps: array<f32>;  // (2 reach + 4, smooths)
@group(0) @binding(3) var<storage, read_write> band_views: array<vec2f>;  // (bands, pictures, h, w)

const fours = (height + 3u) / 4u;
const size = pictures * height * width;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pictures * fours * width) { return; }
    let y = 4u * (i / width % fours);
    let first = i / (width * fours) * width * height + i % width;
    var weights: array<vec4f, smooths>;
    var p: array<vec4f, smooths + 1u>;
    var q: array<vec4f, smooths + 1u>;
    let rest = min(4u, height - y);
    for (var n = 0u; n < rest; n++) {
        let here = joined[first + (y + n) * width];
        p[0][n] = here.x;
        q[0][n] = here.y;
    }
    for (var k = 0u; k < 2u * reach + 4u; k++) {
        let at = first + mirrored(i32(y + k) - i32(reach), height) * width;
        for (var s = 0u; s < smooths; s++) {
            let here = smooth_rows[s * size + at];
            weights[s] = vec4f(taps[k * smooths + s], weights[s].xyz);
            p[s + 1u] += weights[s] * here.x;
            q[s + 1u] += weights[s] * here.y;
        }
    }
    for (var band = 0u; band < bands; band++) {
        let a = (fine >> (4u * band)) & 15u;
        let b = (coarse >> (4u * band)) & 15u;
        let of_p = p[a] - p[b];
        let of_q = q[a] - q[b];
        for (var n = 0u; n < rest; n++) { band_views[band * size + first + (y + n) * width] = vec2f(of_p[n], of_q[n]); }
    }
}
