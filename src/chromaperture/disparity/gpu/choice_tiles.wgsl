// Lowest and highest plane of every tile of pixels: where they are the same all around, no pixel lies beside another plane.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read_write> tiles: array<vec2u>;  // (h / tile, w / tile), rounded up

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let across = (width + tile - 1u) / tile;
    if (i >= across * ((height + tile - 1u) / tile)) { return; }
    let top = i / across * tile;
    let left = i % across * tile;
    var found = vec2u(0xffffffffu, 0u);
    for (var y = top; y < min(top + tile, height); y++) {
        for (var x = left; x < min(left + tile, width); x++) {
            let here = choice[y * width + x];
            found = vec2u(min(found.x, here), max(found.y, here));
        }
    }
    tiles[i] = found;
}
