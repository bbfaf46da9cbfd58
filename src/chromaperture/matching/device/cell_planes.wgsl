// Views, guide and mask at every second pixel, after which cells are named.

@group(0) @binding(0) var<storage, read> planes: array<f32>;  // (planes, h, w)
@group(0) @binding(1) var<storage, read_write> cells: array<f32>;  // (planes, ceil(h / 2), ceil(w / 2))

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= plane_count * cells_wide * cells_tall) { return; }
    let x = 2u * (i % cells_wide);
    let y = 2u * ((i / cells_wide) % cells_tall);
    cells[i] = planes[(i / (cells_wide * cells_tall)) * width * height + y * width + x];
}
