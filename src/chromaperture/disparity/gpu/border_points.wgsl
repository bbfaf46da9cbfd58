// Where lines cross borders, and how many do in every workgroup.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> planes: array<vec4f>;  // of grid points: a, b, c in layers
@group(0) @binding(2) var<storage, read_write> line_at: array<u32>;  // (2, h, w): 1 where one does
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;  // of workgroups

var<workgroup> found: array<u32, 64>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    var own = 0u;
    if (i < 2u * width * height) {
        own = select(0u, 1u, border_at(i).is_heard);
        line_at[i] = own;
    }
    found[local] = own;
    workgroupBarrier();
    if (local == 0u) {
        var sum = 0u;
        for (var k = 0u; k < 64u; k++) { sum += found[k]; }
        counts[group.x + group.y * groups.x] = sum;
    }
}
