// Which columns of which bands of the halved picture have unusable pixels.

@group(0) @binding(0) var<storage, read> planes: array<f32>;  // (K + 2, h, w): views, guide, usable share
@group(0) @binding(1) var<storage, read_write> unusable: array<u32>;  // (bands, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= band_count * width) { return; }
    let first = (i / width) * band_height;
    var found = 0u;
    for (var y = first; y < min(first + band_height, height); y++) {
        if (planes[(view_count + 1u) * width * height + y * width + i % width] <= usable_share) { found = 1u; }
    }
    unusable[i] = found;
}
