// Which share of the views' variance in a window of cells is not that of their mean (quality "paper"), as
// `unlike_views.unlike_share`.

@group(0) @binding(0) var<storage, read> moments: array<vec4f>;  // (2, rows, columns): views first, their mean last
@group(0) @binding(1) var<storage, read_write> share: array<f32>;  // (rows, columns)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= columns * rows) { return; }
    let x = i32(i % columns) - i32(side / 2u);
    let y = i32(i / columns) - i32(side / 2u);
    let here = moments[i];  // differences from it are exact where there is little texture
    var mean = vec4f();
    var square = vec4f();
    for (var n = 0u; n < side * side; n++) {
        let at = inside(y + i32(n / side), rows) * columns + inside(x + i32(n % side), columns);
        let away = moments[at] - here;
        mean += away / f32(side * side);
        square += (away * away + moments[columns * rows + at]) / f32(side * side);
    }
    let variances = max(square - mean * mean, vec4f());
    let total = (variances.x + variances.y + variances.z) / f32(view_count);
    share[i] = clamp((total - variances.w) / (total + least_variance), 0.0, 1.0);
}
