// The transform of `cross_columns.wgsl` along the rows: P and Q of the middle of every tile as the real and the imaginary
// part of one picture. Two rows go side by side.

@group(0) @binding(1) var<storage, read> columns: array<vec4f>;  // (pictures, middle, kept)
@group(0) @binding(2) var<storage, read_write> views: array<vec2f>;  // (pictures, middle, middle)

const kept = span / 2u;

// P + i Q at a frequency, or at the negative of this one.
fn joined(both: vec4f, negative: bool) -> vec2f {
    return select(vec2f(both.x - both.w, both.y + both.z), vec2f(both.x + both.w, both.z - both.y), negative);
}

fn taken(line: u32, x: u32) -> vec4f {
    if (x == kept) { return vec4f(); }
    let at = 2u * line * kept + select(x, span - x, x > kept);
    return vec4f(joined(columns[at], x > kept), joined(columns[at + kept], x > kept));
}

fn given(line: u32, x: u32, value: vec4f) {
    let column = x - (span - middle) / 2u;
    if (column < middle) {
        views[2u * line * middle + column] = value.xy;
        views[(2u * line + 1u) * middle + column] = value.zw;
    }
}

@compute @workgroup_size(group_size)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    transform((group.x + group.y * groups.x) * lines_of_group, local);
}
