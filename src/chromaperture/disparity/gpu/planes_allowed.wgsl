// Finds where the surface allows the planes that explain it; see `plane_agreement.py`. Where the surface lies between its
// own plane and a nearer one beside it, the plane stays.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> planes: array<vec4f>;  // a, b, c in layers
@group(0) @binding(2) var<storage, read> tiles: array<vec2u>;  // lowest and highest plane of `tile` x `tile` px
@group(0) @binding(3) var<storage, read> apart: array<u32>;  // (h, w)
@group(0) @binding(4) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(5) var<storage, read> there: array<f32>;  // (h, w): layer of the plane
@group(0) @binding(6) var<storage, read> first: array<f32>;  // (h, w): layer of the surface
@group(0) @binding(7) var<storage, read_write> agreed: array<u32>;  // (h, w): 1 where the plane is allowed

// Whether all around lies on one plane, as far as `tile` px.
fn is_alone(y: u32, x: u32) -> bool {
    let across = (width + tile - 1u) / tile;
    let down = (height + tile - 1u) / tile;
    var found = vec2u(0xffffffffu, 0u);
    for (var v = max(y / tile, 1u) - 1u; v <= min(y / tile + 1u, down - 1u); v++) {
        for (var u = max(x / tile, 1u) - 1u; u <= min(x / tile + 1u, across - 1u); u++) {
            let here = tiles[v * across + u];
            found = vec2u(min(found.x, here.x), max(found.y, here.y));
        }
    }
    return found.x == found.y;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let u = first[i];
    let own = choice[i];
    let bar = sqrt(sigma[i] * sigma[i] + 1.0);
    var stays = apart[i] == 0u;
    if (!stays && u <= there[i] + bar && !is_alone(i / width, i % width)) {
        let y = i32(i / width);
        let x = i32(i % width);
        let terms = vec4f(f32(x), f32(y), 1.0, 0.0);
        for (var v = max(y - i32(reach), 0i); v <= min(y + i32(reach), i32(height) - 1i); v++) {
            let wide = i32(disc[u32(v - y + i32(reach))]);
            for (var w = max(x - wide, 0i); w <= min(x + wide, i32(width) - 1i); w++) {
                let other = choice[u32(v) * width + u32(w)];
                let near = dot(planes[other], terms);
                stays = stays || (other != own && near < there[i] && u >= near - bar);
            }
        }
    }
    agreed[i] = select(0u, 1u, stays);
}
