// Gaussian along one axis, of some planes of one array into the same planes of another. Where `sparse`, only what
// `fill.wgsl` reads, at unusable pixels, and what that is made of: columns next to unusable pixels.

@group(0) @binding(0) var<storage, read> before: array<f32>;  // (planes, h, w)
@group(0) @binding(1) var<storage, read> unusable: array<u32>;  // (bands, w): 1 where a column of a band has one
@group(0) @binding(2) var<storage, read_write> after: array<f32>;  // (planes, h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= plane_count * width * height) { return; }
    let x = i % width;
    let y = (i / width) % height;
    if (sparse) {
        let band = y / band_height;  // a band is as high as the Gaussian reaches
        let above = unusable[max(band, 1u) * width - width + x];
        let below = unusable[min(band + 1u, band_count - 1u) * width + x];
        if ((above | unusable[band * width + x] | below) == 0u) { return; }
    }
    let base = (first_plane + i / (width * height)) * width * height;
    var sum = 0.0;
    for (var j = 0u; j < 2u * reach + 1u; j++) {
        var at = 0u;
        let step = i32(j) - i32(reach);
        if (along_x) {
            at = y * width + select(mirrored(i32(x) + step, width), inside(i32(x) + step, width), replicate);
        } else {
            at = select(mirrored(i32(y) + step, height), inside(i32(y) + step, height), replicate) * width + x;
        }
        sum += taps[j] * before[base + at];
    }
    after[base + y * width + x] = sum;
}
