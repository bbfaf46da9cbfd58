// The same along the columns: spectra of the tiles as coarser samples have them, one value for one pixel's. Two of all
// columns go side by side.

@group(0) @binding(1) var<storage, read> rows: array<vec2f>;  // (tiles, 3, span, kept)
@group(0) @binding(2) var<storage, read_write> spectra: array<vec2f>;  // (tiles, 3, size, size / 2 + 1)

fn entry(column: u32, y: u32) -> vec2f {
    return rows[(column / kept * span + y) * kept + column % kept];
}

fn taken(line: u32, y: u32) -> vec4f {
    return vec4f(entry(2u * line, y), entry(2u * line + 1u, y));
}

fn given(line: u32, place: u32, value: vec4f) {
    if (place >= kept && place <= span - kept) { return; }
    let y = select(place, place + size - span, place >= kept);
    for (var k = 0u; k < 2u; k++) {
        let column = 2u * line + k;
        spectra[(column / kept * size + y) * (size / 2u + 1u) + column % kept] = select(value.xy, value.zw, k == 1u) * gain;
    }
}

@compute @workgroup_size(group_size)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    transform((group.x + group.y * groups.x) * lines_of_group, local);
}
