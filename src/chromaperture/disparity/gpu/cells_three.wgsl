// Sums of three views for `cell_scores.wgsl`, as `cells_two.wgsl`.

alias Starts = vec3u;

struct Row {
    means: vec3f,
    squares: vec3f,
    products: vec3f,  // 01, 02, 12
}

fn starts_of(layer: u32, x: u32, y: u32) -> Starts {
    return Starts(start_of(0u, layer, x, y), start_of(1u, layer, x, y), start_of(2u, layer, x, y));
}

fn samples_at(at: Starts) -> vec3f {
    return vec3f(samples[at.x], samples[at.y], samples[at.z]);
}

fn row_sums(middle: Starts) -> Row {
    let light = samples_at(middle);
    let outer = samples_at(middle - 2u * entry_count) - light;
    let inner = samples_at(middle - entry_count) - light;
    let beyond = samples_at(middle + entry_count) - light;
    let last = samples_at(middle + 2u * entry_count) - light;
    let sums = outer + last + 2.0 * (inner + beyond);
    let squares = outer * outer + last * last + 2.0 * (inner * inner + beyond * beyond);
    let products = outer.xxy * outer.yzz + last.xxy * last.yzz + 2.0 * (inner.xxy * inner.yzz + beyond.xxy * beyond.yzz);
    return Row(9.0 * light + sums, (8.0 * squares + squares) - sums * sums, (8.0 * products + products) - sums.xxy * sums.yzz);
}

// 1 - sqrt(det) of the correlations of rows that are joined to a window. The determinant is (1 - r01^2) (1 - r02^2)
// - (r12 - r01 r02)^2, not a sum whose parts cancel.
fn score_of(a: Row, b: Row, c: Row, d: Row, e: Row, floors: vec3f) -> f32 {
    let total = (a.means + e.means + c.means) + 2.0 * (b.means + d.means + c.means);
    let middle = round(total * (1.0 / 9.0));
    let left = total - 9.0 * middle;
    let means_a = a.means - middle;
    let means_b = b.means - middle;
    let means_c = c.means - middle;
    let means_d = d.means - middle;
    let means_e = e.means - middle;
    var ends = a.squares + e.squares + means_a * means_a + means_e * means_e;
    var inside = b.squares + d.squares + means_b * means_b + means_d * means_d;
    var inmost = c.squares + means_c * means_c;
    var value = (ends + inmost) + 2.0 * (inside + inmost);
    let variances = max((8.0 * value + value) - left * left, vec3f()) + floors;
    ends = a.products + e.products + means_a.xxy * means_a.yzz + means_e.xxy * means_e.yzz;
    inside = b.products + d.products + means_b.xxy * means_b.yzz + means_d.xxy * means_d.yzz;
    inmost = c.products + means_c.xxy * means_c.yzz;
    value = (ends + inmost) + 2.0 * (inside + inmost);
    let joined = (8.0 * value + value) - left.xxy * left.yzz;
    let rho = clamp(joined / sqrt(max(variances.xxy * variances.yzz, vec3f(1.0e-37))), vec3f(-1.0), vec3f(1.0));
    let apart = rho.z - rho.x * rho.y;
    return 1.0 - sqrt(max((1.0 - rho.x * rho.x) * (1.0 - rho.y * rho.y) - apart * apart, 0.0));
}
