// All Gaussians of the bands along the columns, and their differences: the bands of P and Q. An invocation has eight
// neighbours, whose pixels overlap. The finest Gaussian is that of P and Q themselves: number 0.

@group(0) @binding(0) var<storage, read> joined: array<vec2f>;  // (pictures, h, w)
@group(0) @binding(1) var<storage, read> smooth_rows: array<vec2f>;  // (smooths, pictures, h, w)
@group(0) @binding(2) var<storage, read> taps: array<f32>;  // (2 reach + 8, smooths)
@group(0) @binding(3) var<storage, read_write> band_views: array<vec2f>;  // (bands, pictures, h, w)

const eights = (height + 7u) / 8u;
const size = pictures * height * width;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pictures * eights * width) { return; }
    let y = 8u * (i / width % eights);
    let first = i / (width * eights) * width * height + i % width;
    var sums: array<Sums, smooths + 1u>;
    for (var n = 0u; n < 4u; n++) {
        let near = joined[first + min(y + n, height - 1u) * width];
        let far = joined[first + min(y + n + 4u, height - 1u) * width];
        sums[0].near_p[n] = near.x;
        sums[0].near_q[n] = near.y;
        sums[0].far_p[n] = far.x;
        sums[0].far_q[n] = far.y;
    }
    for (var k = 0u; k < 2u * reach + 8u; k++) {
        let at = first + mirrored(i32(y + k) - i32(reach), height) * width;
        for (var s = 0u; s < smooths; s++) {
            sums[s + 1u] = added(sums[s + 1u], taps[k * smooths + s], smooth_rows[s * size + at]);
        }
    }
    for (var band = 0u; band < bands; band++) {
        let a = sums[(fine >> (4u * band)) & 15u];
        let b = sums[(coarse >> (4u * band)) & 15u];
        let to = band * size + first + y * width;
        for (var n = 0u; n < 4u; n++) {
            if (y + n < height) { band_views[to + n * width] = vec2f(a.near_p[n] - b.near_p[n], a.near_q[n] - b.near_q[n]); }
            if (y + n + 4u < height) {
                band_views[to + (n + 4u) * width] = vec2f(a.far_p[n] - b.far_p[n], a.far_q[n] - b.far_q[n]);
            }
        }
    }
}
