// Leaves out the spots of difference that lie inside an area of agreement.

@group(0) @binding(0) var<storage, read> areas: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> spots: array<u32>;  // (h, w)
@group(0) @binding(2) var<storage, read> area_sums: array<vec2u>;  // pixels, of which differ
@group(0) @binding(3) var<storage, read> spot_sums: array<vec2u>;  // pixels, of which touch the border
@group(0) @binding(4) var<storage, read_write> apart: array<u32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height || apart[i] == 0u) { return; }
    let area = vec2f(area_sums[areas[i]]);
    let spot = spot_sums[spots[i]];
    let surrounded = spot.y * spot.y <= spot.x;
    if (area.y <= (1.0 - whole_share) * area.x || (area.y <= (1.0 - surrounded_share) * area.x && surrounded)) {
        apart[i] = 0u;
    }
}
