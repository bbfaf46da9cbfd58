// Products of windows of a picture with tapered waves along y, at every column; see `spectral_model.py`, Windows.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (h, w, 3)
@group(0) @binding(1) var<storage, read> shading: array<f32>;  // alike
@group(0) @binding(2) var<storage, read> waves: array<vec4f>;  // (side, pairs): cosine and sine of two waves
@group(0) @binding(3) var<storage, read_write> rows: array<vec4f>;  // (window rows, pairs, w, 3)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= window_rows * pairs * width * 3u) { return; }
    let column = i % (3u * width);
    let pair = i / (3u * width) % pairs;
    let top = i32(i / (3u * width * pairs) * stride) - i32(side / 2u);
    var sum = vec4f();
    for (var s = 0u; s < side; s++) {
        let at = repeated(top + i32(s), height) * 3u * width + column;
        sum += (image[at] - shading[at]) * waves[s * pairs + pair];
    }
    rows[i] = sum;
}
