// For `conversion.wgsl`: A, B, delta and six covariances lie behind one another, each (H, W) or one number.

fn field(number: u32, i: u32) -> f32 {
    return fields[u32(field_at[number]) + select(0u, i, field_is_map[number] > 0.0)];
}
