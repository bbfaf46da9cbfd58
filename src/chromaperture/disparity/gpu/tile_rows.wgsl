// Fourier transforms of the rows of all tiles of a photograph without its shading: the low frequencies only.

@group(0) @binding(1) var<storage, read> image: array<f32>;  // (h, w, 3)
@group(0) @binding(2) var<storage, read> shading: array<f32>;  // (h, w, 3)
@group(0) @binding(3) var<storage, read> corners: array<i32>;  // (tiles, 2): x and y of a tile's first pixel
@group(0) @binding(4) var<storage, read_write> rows: array<vec2f>;  // (tiles, 3, span, kept)

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let first = (group.x + group.y * groups.x) * lines_of_group;
    for (var i = local; i < lines_of_group * span; i += 128u) {
        let row = min(first + i / span, lines - 1u);
        let tile = row / (3u * span);
        let x = mirrored(corners[2u * tile] + i32(i % span), width);
        let y = mirrored(corners[2u * tile + 1u] + i32(row % span), height);
        let at = (y * width + x) * 3u + row / span % 3u;
        line[i] = vec2f(image[at] - shading[at], 0.0);
    }
    let start = transformed(local);
    for (var i = local; i < lines_of_group * kept; i += 128u) {
        let row = first + i / kept;
        if (row < lines) { rows[row * kept + i % kept] = line[start + i / kept * span + i % kept]; }
    }
}
