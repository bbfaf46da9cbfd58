// All Gaussians of the bands along the rows of P and Q. An invocation has eight neighbours, whose pixels overlap.

@group(0) @binding(0) var<storage, read> joined: array<vec2f>;  // (pictures, h, w)
@group(0) @binding(1) var<storage, read> taps: array<f32>;  // (2 reach + 8, smooths): seven zeros at the end
@group(0) @binding(2) var<storage, read_write> smooth_rows: array<vec2f>;  // (smooths, pictures, h, w)

const eights = (width + 7u) / 8u;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pictures * height * eights) { return; }
    let x = 8u * (i % eights);
    let row = i / eights * width;
    var sums: array<Sums, smooths>;
    for (var k = 0u; k < 2u * reach + 8u; k++) {
        let here = joined[row + mirrored(i32(x + k) - i32(reach), width)];
        for (var s = 0u; s < smooths; s++) { sums[s] = added(sums[s], taps[k * smooths + s], here); }
    }
    for (var s = 0u; s < smooths; s++) {
        let first = s * pictures * height * width + row + x;
        for (var n = 0u; n < 4u; n++) {
            if (x + n < width) { smooth_rows[first + n] = vec2f(sums[s].near_p[n], sums[s].near_q[n]); }
            if (x + n + 4u < width) { smooth_rows[first + n + 4u] = vec2f(sums[s].far_p[n], sums[s].far_q[n]); }
        }
    }
}
