// A layer convolved with the pupil's picture, mirrored at the border of its box.

@group(0) @binding(0) var<storage, read> cells: array<vec4f>;  // (cells_tall, cells_wide)
@group(0) @binding(1) var<storage, read> kernel: array<f32>;  // (side, side), odd
@group(0) @binding(2) var<storage, read> layer: Layer;
@group(0) @binding(3) var<storage, read_write> blurred: array<vec4f>;  // (cells_tall, cells_wide)

// With the border's own cell (BORDER_REFLECT of OpenCV).
fn reflected(at: i32, count: u32) -> u32 {
    var place = at;
    while (place < 0i || place >= i32(count)) { place = select(2i * i32(count) - 1i - place, -1i - place, place < 0i); }
    return u32(place);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= layer.cells_tall * layer.cells_wide) { return; }
    let reach = i32(layer.side / 2u);
    let x = i32(i % layer.cells_wide) + reach;
    let y = i32(i / layer.cells_wide) + reach;
    var sum = vec4f();
    for (var row = 0u; row < layer.side; row++) {
        let line = reflected(y - i32(row), layer.cells_tall) * layer.cells_wide;
        for (var column = 0u; column < layer.side; column++) {
            let weight = kernel[row * layer.side + column];
            if (weight != 0.0) { sum += weight * cells[line + reflected(x - i32(column), layer.cells_wide)]; }
        }
    }
    blurred[i] = sum;
}
