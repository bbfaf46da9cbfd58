// Lowest and highest known disparity along x (quality "paper"), for `peak_range.wgsl`.

@group(0) @binding(0) var<storage, read> peaks: array<f32>;  // (3, H, W): disparity, its error bar, score
@group(0) @binding(1) var<storage, read_write> ranges: array<vec2f>;  // (H, W): lowest, highest

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let x = i32(i % width);
    let first = i - i % width;
    var low = 1.0e30;
    var high = -1.0e30;
    for (var n = 0u; n < side; n++) {  // unrolled
        let here = peaks[first + inside(x + i32(n) - i32(reach), width)];
        low = min(low, here);
        high = max(high, select(-1.0e30, here, is_known(here)));  // unknown is larger than all that is known
    }
    ranges[i] = vec2f(low, high);
}
