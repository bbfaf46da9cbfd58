// How far a grid point is from the next one of another plane; beyond `around` not looked for.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read_write> inside: array<f32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let y = i32(i / width);
    let x = i32(i % width);
    let own = choice[i];
    var least = f32(around) + 1.0;
    for (var v = max(y - i32(around), 0i); v <= min(y + i32(around), i32(height) - 1i); v++) {
        for (var u = max(x - i32(around), 0i); u <= min(x + i32(around), i32(width) - 1i); u++) {
            if (choice[u32(v) * width + u32(u)] != own) { least = min(least, chamfer(v - y, u - x)); }
        }
    }
    inside[i] = least;
}
