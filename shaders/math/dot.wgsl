// The scalar product, in place of WGSL's own. SPIR-V leaves the order of sums in its own scalar product to the driver.
// So strict arithmetic would give other bits on other adapters.
fn dot(a: vec3<real>, b: vec3<real>) -> real {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
