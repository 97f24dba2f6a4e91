fn branches(u: mat4x2<f32>, v: mat4x2<f32>, n_3: u32) -> vec2<f32> {
    var y_12: vec2<f32>;

    y_12 = u[0];
    if (u[1].x > 0f) {
        let _e8 = y_12;
        let _e10 = df64_mul(_e8, u[2]);
        y_12 = _e10;
        let _e14 = df64_less_equal(v[1], u[0]);
        if _e14 {
            let _e15 = y_12;
            let _e17 = df64_add(_e15, v[0]);
            y_12 = _e17;
        }
    } else {
        let _e19 = y_12;
        let _e20 = y_12;
        let _e21 = df64_mul(_e19, _e20);
        let _e22 = df64_sub(v[2], _e21);
        y_12 = _e22;
    }
    let _e23 = y_12;
    let _e25 = df64_mul(_e23, u[3]);
    return _e25;
}

fn moved(pose: Pose, by: vec2<f32>) -> Pose {
    let _e8 = df64_mul(by, pose.place[2]);
    let _e9 = df64_mul(by, pose.place[0]);
    let _e10 = df64_mul(by, pose.place[1]);
    let _e15 = df64_add(pose.place[0], _e8);
    let _e16 = df64_add(pose.place[1], _e9);
    let _e17 = df64_add(pose.place[2], _e10);
    let _e21 = df64_mul(pose.weight, by);
    return Pose(mat3x2<f32>(_e15, _e16, _e17), pose.kind, _e21);
}

fn a_struct(u_1: mat4x2<f32>, v_1: mat4x2<f32>, n_4: u32) -> vec2<f32> {
    var pose_1: Pose;

    pose_1 = Pose(mat3x2<f32>(u_1[0], u_1[1], u_1[2]), n_4, u_1[3]);
    let _e9 = pose_1;
    let _e12 = moved(_e9, v_1[0]);
    pose_1 = _e12;
    let _e16 = pose_1.weight;
    pose_1.place[0] = _e16;
    let _e17 = pose_1;
    let _e19 = moved(_e17, v_1[1]);
    let _e25 = df64_dot(_e19.place, mat3x2<f32>(v_1[0], v_1[1], v_1[2]));
    let _e27 = df64_mul(_e25, _e19.weight);
    return _e27;
}

fn scaled_by(y_13: ptr<function, mat3x2<f32>>, by_1: vec2<f32>) -> vec2<f32> {
    let before = (*y_13)[0];
    let _e3 = (*y_13);
    let _e8 = df64_mul(_e3[0], by_1);
    let _e9 = df64_mul(_e3[1], by_1);
    let _e10 = df64_mul(_e3[2], by_1);
    (*y_13) = mat3x2<f32>(_e8, _e9, _e10);
    let _e12 = df64_add(before, by_1);
    return _e12;
}

fn behind_a_pointer(u_2: mat4x2<f32>, v_2: mat4x2<f32>, n_5: u32) -> vec2<f32> {
    var y_14: mat3x2<f32>;

    y_14 = mat3x2<f32>(u_2[0], u_2[1], u_2[2]);
    let _e8 = scaled_by((&y_14), v_2[0]);
    let _e9 = y_14;
    let _e14 = df64_dot(_e9, mat3x2<f32>(v_2[0], v_2[1], v_2[2]));
    let _e15 = df64_mul(_e14, _e8);
    let _e17 = scaled_by((&y_14), u_2[3]);
    let _e19 = y_14[2];
    let _e20 = df64_mul(_e17, _e19);
    let _e21 = df64_add(_e15, _e20);
    return _e21;
}

