// Gaussian along one axis, of some planes of one array into the same planes of another. Where `sparse`, only what
// `fill.wgsl` reads, at unusable pixels, and what that is made of: columns next to unusable pixels. One invocation takes
// four neighbours along the axis, whose pixels overlap. Where `whole`, the sums are rounded to whole units of light.

@group(0) @binding(0) var<storage, read> before: array<f32>;  // (planes, h, w)
@group(0) @binding(1) var<storage, read> unusable: array<u32>;  // (bands, w): 1 where a column of a band has one
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read_write> after: array<f32>;  // (planes, h, w)

fn is_needed(x: u32, y: u32) -> bool {
    let band = y / band_height;  // a band is as high as the Gaussian reaches
    let above = unusable[max(band, 1u) * width - width + x];
    let below = unusable[min(band + 1u, band_count - 1u) * width + x];
    return (above | unusable[band * width + x] | below) != 0u;
}

fn pixel_at(base: u32, place: i32, length: u32, stride: u32) -> f32 {
    return before[base + select(mirrored(place, length), inside(place, length), replicate) * stride];
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let length = select(height, width, along_x);
    let each = (length + 3u) / 4u;  // invocations of a line
    if (i >= each * select(width, height, along_x)) { return; }
    // Along y neighbours in memory are neighbouring lines.
    let line = select(i % width, i / each, along_x);
    let first = 4u * select(i / width, i % each, along_x);
    let stride = select(width, 1u, along_x);
    let start = select(line, line * width, along_x);
    if (sparse) {
        var needed = false;
        for (var j = first; j < min(first + 4u, length); j++) {
            needed = needed || is_needed(select(line, j, along_x), select(j, line, along_x));
        }
        if (!needed) { return; }
    }
    for (var plane = first_plane; plane < first_plane + plane_count; plane++) {
        let base = plane * width * height + start;
        var sums = sums_of(base, i32(first) - i32(reach), length, stride);
        if (whole) { sums = stats[UNIT] * round(stats[UNIT + 1u] * sums); }
        for (var j = 0u; j < min(4u, length - first); j++) { after[base + (first + j) * stride] = sums[j]; }
    }
}
