// Both Gaussians of every band along the columns, and their difference: the band of P and Q.

@group(0) @binding(0) var<storage, read> smooth_rows: array<vec4f>;  // (bands, pictures, h, w)
@group(0) @binding(1) var<storage, read> taps: array<f32>;
@group(0) @binding(2) var<storage, read_write> band_views: array<vec2f>;  // (bands, pictures, h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= bands * pictures * width * height) { return; }
    let band = i / (pictures * width * height);
    let x = i % width;
    let y = i / width % height;
    let picture = i / (width * height) * width * height;
    var sum = vec2f();
    for (var k = 0u; k < 2u * reach + 1u; k++) {
        let here = smooth_rows[picture + mirrored(i32(y + k) - i32(reach), height) * width + x];
        sum += taps[2u * band * (2u * reach + 1u) + k] * here.xy;
        sum -= taps[(2u * band + 1u) * (2u * reach + 1u) + k] * here.zw;
    }
    band_views[i] = sum;
}
