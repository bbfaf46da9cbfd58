// The same along the columns: spectra of the tiles as coarser samples have them, one value for one pixel's.

@group(0) @binding(1) var<storage, read> rows: array<vec2f>;  // (tiles, 3, span, kept)
@group(0) @binding(2) var<storage, read_write> spectra: array<vec2f>;  // (tiles, 3, size, size / 2 + 1)

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let first = (group.x + group.y * groups.x) * lines_of_group;
    for (var i = local; i < lines_of_group * span; i += 128u) {
        // Neighbouring invocations read neighbouring columns.
        let column = min(first + i % lines_of_group, lines - 1u);
        let y = i / lines_of_group;
        line[i % lines_of_group * span + y] = rows[(column / kept * span + y) * kept + column % kept];
    }
    let start = transformed(local);
    for (var i = local; i < lines_of_group * size; i += 128u) {
        let column = first + i % lines_of_group;
        let y = i / lines_of_group;
        if (column < lines && y != kept) {
            let at = start + i % lines_of_group * span + select(y, span - size + y, y > kept);
            spectra[(column / kept * size + y) * (size / 2u + 1u) + column % kept] = line[at] * gain;
        }
    }
}
