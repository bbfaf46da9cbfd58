// Takes the planes where they are allowed, which squares of pixels have alike, or lie within `within` layers of the surface
// that they explain, else the surface. Where an edge moved, a plane is allowed if most of what it had before is.

@group(0) @binding(0) var<storage, read> allowed: array<u32>;  // (h / block, w / block)
@group(0) @binding(1) var<storage, read> before: array<u32>;  // (h / block, w / block): planes
@group(0) @binding(2) var<storage, read> sums: array<vec2u>;  // (planes,): squares before, of which allowed
@group(0) @binding(3) var<storage, read> choice: array<u32>;  // (h, w): planes
@group(0) @binding(4) var<storage, read> there: array<f32>;  // (h, w): layer of the plane
@group(0) @binding(5) var<storage, read_write> surface: array<vec4f>;  // (h, w): layer first

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let square = block_at(i / width, i % width);
    let moved = choice[i] != before[square];
    let mostly = 2u * sums[choice[i]].y > sums[choice[i]].x;
    let near = abs(there[i] - surface[i].x) <= within;
    if (near || allowed[square] == 1u || (moved && mostly)) { surface[i].x = there[i]; }
}
