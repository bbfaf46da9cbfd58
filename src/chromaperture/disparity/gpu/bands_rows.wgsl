// Both Gaussians of every band along the rows of P and Q.

@group(0) @binding(0) var<storage, read> joined: array<vec2f>;  // (pictures, h, w)
@group(0) @binding(1) var<storage, read> taps: array<f32>;  // (bands, 2, 2 reach + 1)
@group(0) @binding(2) var<storage, read_write> smooth_rows: array<vec4f>;  // (bands, pictures, h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= bands * pictures * width * height) { return; }
    let band = i / (pictures * width * height);
    let x = i % width;
    let row = i / width % (pictures * height) * width;
    var fine = vec2f();
    var coarse = vec2f();
    for (var k = 0u; k < 2u * reach + 1u; k++) {
        let here = joined[row + mirrored(i32(x + k) - i32(reach), width)];
        fine += taps[2u * band * (2u * reach + 1u) + k] * here;
        coarse += taps[(2u * band + 1u) * (2u * reach + 1u) + k] * here;
    }
    smooth_rows[i] = vec4f(fine, coarse);
}
