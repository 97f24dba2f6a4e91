fn branches(u: vec4<f64>, v: vec4<f64>, n: u32) -> f64 {
    var y: f64;

    y = u.x;
    if (u.y > 0.0lf) {
        let _e8 = y;
        y = (_e8 * u.z);
        if (v.y <= u.x) {
            let _e14 = y;
            y = (_e14 + v.x);
        }
    } else {
        let _e18 = y;
        let _e19 = y;
        y = (v.z - (_e18 * _e19));
    }
    let _e22 = y;
    return (_e22 * u.w);
}

fn moved(pose: Pose, by: f64) -> Pose {
    return Pose((pose.place + (by * pose.place.zxy)), pose.kind, (pose.weight * by));
}

fn a_struct(u_1: vec4<f64>, v_1: vec4<f64>, n_1: u32) -> f64 {
    var pose_1: Pose;

    pose_1 = Pose(u_1.xyz, n_1, u_1.w);
    let _e7 = pose_1;
    let _e9 = moved(_e7, v_1.x);
    pose_1 = _e9;
    let _e13 = pose_1.weight;
    pose_1.place.x = _e13;
    let _e14 = pose_1;
    let _e16 = moved(_e14, v_1.y);
    return (dot(_e16.place, v_1.xyz) * _e16.weight);
}

fn scaled_by(y_1: ptr<function, vec3<f64>>, by_1: f64) -> f64 {
    let before = (*y_1).x;
    let _e4 = (*y_1);
    (*y_1) = (_e4 * by_1);
    return (before + by_1);
}

fn behind_a_pointer(u_2: vec4<f64>, v_2: vec4<f64>, n_2: u32) -> f64 {
    var y_2: vec3<f64>;

    y_2 = u_2.xyz;
    let _e6 = scaled_by((&y_2), v_2.x);
    let _e7 = y_2;
    let _e12 = scaled_by((&y_2), u_2.w);
    let _e14 = y_2.z;
    return ((dot(_e7, v_2.xyz) * _e6) + (_e12 * _e14));
}

fn branches_with_tangents(u_3: vec4<f64>, u_tangent_1_: vec4<f64>, v_3: vec4<f64>, v_tangent_1_: vec4<f64>, n_3: u32) -> Dual_0_ {
    var y_3: f64;
    var y_tangent_1_: f64;

    y_3 = u_3.x;
    y_tangent_1_ = u_tangent_1_.x;
    if (u_3.y > 0.0lf) {
        let _e10 = y_3;
        let _e11 = y_tangent_1_;
        y_3 = (_e10 * u_3.z);
        y_tangent_1_ = ((_e11 * u_3.z) + (_e10 * u_tangent_1_.z));
        if (v_3.y <= u_3.x) {
            let _e25 = y_3;
            let _e26 = y_tangent_1_;
            y_3 = (_e25 + v_3.x);
            y_tangent_1_ = (_e26 + v_tangent_1_.x);
        }
    } else {
        let _e33 = y_3;
        let _e34 = y_tangent_1_;
        let _e35 = y_3;
        let _e36 = y_tangent_1_;
        y_3 = (v_3.z - (_e33 * _e35));
        y_tangent_1_ = (v_tangent_1_.z + -(((_e34 * _e35) + (_e33 * _e36))));
    }
    let _e44 = y_3;
    let _e45 = y_tangent_1_;
    return Dual_0_((_e44 * u_3.w), ((_e45 * u_3.w) + (_e44 * u_tangent_1_.w)));
}

fn moved_with_tangents(pose_2: Pose, pose_tangent_1_: Pose, by_2: f64, by_tangent_1_: f64) -> Dual_5_ {
    let _e6 = pose_2.place.zxy;
    return Dual_5_(Pose((pose_2.place + (by_2 * _e6)), pose_2.kind, (pose_2.weight * by_2)), Pose((pose_tangent_1_.place + ((by_tangent_1_ * _e6) + (by_2 * pose_tangent_1_.place.zxy))), u32(), ((pose_tangent_1_.weight * by_2) + (pose_2.weight * by_tangent_1_))));
}

fn a_struct_with_tangents(u_4: vec4<f64>, u_tangent_1_1: vec4<f64>, v_4: vec4<f64>, v_tangent_1_1: vec4<f64>, n_4: u32) -> Dual_0_ {
    var pose_3: Pose;
    var pose_tangent_1_1: Pose;

    pose_3 = Pose(u_4.xyz, n_4, u_4.w);
    pose_tangent_1_1 = Pose(u_tangent_1_1.xyz, u32(), u_tangent_1_1.w);
    let _e12 = pose_3;
    let _e13 = pose_tangent_1_1;
    let _e18 = moved_with_tangents(_e12, _e13, v_4.x, v_tangent_1_1.x);
    pose_3 = _e18.value;
    pose_tangent_1_1 = _e18.tangent_1_;
    let _e27 = pose_3.weight;
    let _e28 = pose_tangent_1_1.weight;
    pose_3.place.x = _e27;
    pose_tangent_1_1.place.x = _e28;
    let _e29 = pose_3;
    let _e30 = pose_tangent_1_1;
    let _e33 = moved_with_tangents(_e29, _e30, v_4.y, v_tangent_1_1.y);
    let last = _e33.value;
    let _e38 = v_4.xyz;
    let _e40 = dot(last.place, _e38);
    return Dual_0_((_e40 * last.weight), (((dot(_e33.tangent_1_.place, _e38) + dot(last.place, v_tangent_1_1.xyz)) * last.weight) + (_e40 * _e33.tangent_1_.weight)));
}

fn scaled_by_with_tangents(y_4: ptr<function, vec3<f64>>, y_tangent_1_1: ptr<function, vec3<f64>>, by_3: f64, by_tangent_1_1: f64) -> Dual_0_ {
    let before_1 = (*y_4).x;
    let _e5 = (*y_tangent_1_1).x;
    let _e6 = (*y_4);
    let _e7 = (*y_tangent_1_1);
    (*y_4) = (_e6 * by_3);
    (*y_tangent_1_1) = ((_e7 * by_3) + (_e6 * by_tangent_1_1));
    return Dual_0_((before_1 + by_3), (_e5 + by_tangent_1_1));
}

fn behind_a_pointer_with_tangents(u_5: vec4<f64>, u_tangent_1_2: vec4<f64>, v_5: vec4<f64>, v_tangent_1_2: vec4<f64>, n_5: u32) -> Dual_0_ {
    var y_5: vec3<f64>;
    var y_tangent_1_2: vec3<f64>;

    y_5 = u_5.xyz;
    y_tangent_1_2 = u_tangent_1_2.xyz;
    let _e10 = scaled_by_with_tangents((&y_5), (&y_tangent_1_2), v_5.x, v_tangent_1_2.x);
    let z = _e10.value;
    let _e13 = y_5;
    let _e14 = y_tangent_1_2;
    let _e15 = v_5.xyz;
    let _e17 = dot(_e13, _e15);
    let _e27 = scaled_by_with_tangents((&y_5), (&y_tangent_1_2), u_5.w, u_tangent_1_2.w);
    let _e32 = y_5.z;
    let _e33 = y_tangent_1_2.z;
    return Dual_0_(((_e17 * z) + (_e27.value * _e32)), ((((dot(_e14, _e15) + dot(_e13, v_tangent_1_2.xyz)) * z) + (_e17 * _e10.tangent_1_)) + ((_e27.tangent_1_ * _e32) + (_e27.value * _e33))));
}

