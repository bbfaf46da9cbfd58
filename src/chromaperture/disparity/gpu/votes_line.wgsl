// Counts along one axis how many of 2 reach + 1 pixels are set; the border's pixel is repeated. In the last of both
// axes, whether so many are.

@group(0) @binding(0) var<storage, read> before: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read_write> after: array<u32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let place = i32(select(i / width, i % width, along_x));
    let last = i32(select(height, width, along_x)) - 1i;
    let stride = i32(select(width, 1u, along_x));
    var votes = 0u;
    for (var k = -i32(reach); k <= i32(reach); k++) {
        votes += before[u32(i32(i) + (clamp(place + k, 0i, last) - place) * stride)];
    }
    after[i] = select(votes, select(0u, 1u, votes >= majority), majority > 0u);
}
