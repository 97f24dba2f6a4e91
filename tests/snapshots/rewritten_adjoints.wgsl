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

fn branches_forward(u_3: vec4<f64>, v_3: vec4<f64>, n_3: u32, record: ptr<function, Record_2_>) -> f64 {
    var y_3: f64;

    y_3 = u_3.x;
    let _e7 = (u_3.y > 0.0lf);
    (*record).member_7_ = _e7;
    if _e7 {
        let _e8 = y_3;
        (*record).member_4_ = _e8;
        (*record).member_3_ = u_3.z;
        y_3 = (_e8 * u_3.z);
        let _e13 = (v_3.y <= u_3.x);
        (*record).member_2_ = _e13;
        if _e13 {
            let _e14 = y_3;
            y_3 = (_e14 + v_3.x);
        }
    } else {
        let _e18 = y_3;
        let _e19 = y_3;
        (*record).member_6_ = _e18;
        (*record).member_5_ = _e19;
        y_3 = (v_3.z - (_e18 * _e19));
    }
    let _e22 = y_3;
    (*record).member_1_ = _e22;
    (*record).member_0_ = u_3.w;
    return (_e22 * u_3.w);
}

fn branches_backward(adjoint: f64, record_1: Record_2_) -> Adjoints_1_ {
    var y_adjoint: f64;
    var adjoint_1: vec4<f64>;
    var adjoint_2: vec4<f64>;

    let _e8 = y_adjoint;
    y_adjoint = (_e8 + (adjoint * record_1.member_0_));
    if record_1.member_7_ {
        if record_1.member_2_ {
            let _e11 = y_adjoint;
            y_adjoint = f64();
            let _e15 = adjoint_1.x;
            adjoint_1.x = (_e15 + _e11);
            let _e18 = y_adjoint;
            y_adjoint = (_e18 + _e11);
        }
        let _e23 = y_adjoint;
        y_adjoint = f64();
        let _e33 = adjoint_2.z;
        adjoint_2.z = (_e33 + (_e23 * record_1.member_4_));
        let _e36 = y_adjoint;
        y_adjoint = (_e36 + (_e23 * record_1.member_3_));
    } else {
        let _e39 = y_adjoint;
        y_adjoint = f64();
        let _e41 = -(_e39);
        let _e49 = y_adjoint;
        y_adjoint = (_e49 + (_e41 * record_1.member_6_));
        let _e52 = y_adjoint;
        y_adjoint = (_e52 + (_e41 * record_1.member_5_));
        let _e56 = adjoint_1.z;
        adjoint_1.z = (_e56 + _e39);
    }
    let _e61 = y_adjoint;
    y_adjoint = f64();
    let _e64 = adjoint_2;
    let _e73 = adjoint_1;
    return Adjoints_1_(vec4<f64>((_e61 + _e64.x), _e64.y, _e64.z, ((adjoint * record_1.member_1_) + _e64.w)), _e73);
}

fn branches_back(u_4: vec4<f64>, v_4: vec4<f64>, n_4: u32, adjoint_u: ptr<function, vec4<f64>>, adjoint_v: ptr<function, vec4<f64>>, adjoint_3: f64) {
    var record_2: Record_2_;

    let _e7 = branches_forward(u_4, v_4, n_4, (&record_2));
    let _e8 = record_2;
    let _e9 = branches_backward(adjoint_3, _e8);
    let _e11 = (*adjoint_u);
    (*adjoint_u) = (_e11 + _e9.member_0_);
    let _e14 = (*adjoint_v);
    (*adjoint_v) = (_e14 + _e9.member_1_);
}

fn moved_forward(pose_2: Pose, by_2: f64, record_3: ptr<function, Record_4_>) -> Pose {
    (*record_3).member_0_ = by_2;
    let _e4 = pose_2.place.zxy;
    (*record_3).member_2_ = _e4;
    (*record_3).member_1_ = pose_2.weight;
    return Pose((pose_2.place + (by_2 * _e4)), pose_2.kind, (pose_2.weight * by_2));
}

fn moved_backward(adjoint_4: Pose, record_4: Record_4_) -> Adjoints_3_ {
    let _e13 = (adjoint_4.place * record_4.member_0_);
    return Adjoints_3_(Pose(vec3<f64>((_e13.y + adjoint_4.place.x), (_e13.z + adjoint_4.place.y), (_e13.x + adjoint_4.place.z)), u32(), (adjoint_4.weight * record_4.member_0_)), ((adjoint_4.weight * record_4.member_1_) + dot(adjoint_4.place, record_4.member_2_)));
}

fn a_struct_forward(u_5: vec4<f64>, v_5: vec4<f64>, n_5: u32, record_5: ptr<function, Record_6_>) -> f64 {
    var pose_3: Pose;
    var record_6: Record_4_;
    var record_7: Record_4_;

    pose_3 = Pose(u_5.xyz, n_5, u_5.w);
    let _e7 = pose_3;
    let _e9 = moved_forward(_e7, v_5.x, (&record_6));
    let _e24 = record_6;
    (*record_5).member_5_ = _e24;
    pose_3 = _e9;
    let _e13 = pose_3.weight;
    pose_3.place.x = _e13;
    let _e14 = pose_3;
    let _e16 = moved_forward(_e14, v_5.y, (&record_7));
    let _e27 = record_7;
    (*record_5).member_4_ = _e27;
    let _e18 = v_5.xyz;
    let _e19 = dot(_e16.place, _e18);
    (*record_5).member_3_ = _e16.place;
    (*record_5).member_2_ = _e18;
    (*record_5).member_1_ = _e19;
    (*record_5).member_0_ = _e16.weight;
    return (_e19 * _e16.weight);
}

fn a_struct_backward(adjoint_5: f64, record_8: Record_6_) -> Adjoints_5_ {
    var pose_adjoint: Pose;

    let _e5 = (adjoint_5 * record_8.member_0_);
    let _e12 = (_e5 * record_8.member_3_);
    let _e20 = moved_backward(Pose((_e5 * record_8.member_2_), u32(), (adjoint_5 * record_8.member_1_)), record_8.member_4_);
    let _e28 = pose_adjoint.place;
    pose_adjoint.place = (_e28 + _e20.member_0_.place);
    let _e31 = pose_adjoint.weight;
    pose_adjoint.weight = (_e31 + _e20.member_0_.weight);
    let _e36 = pose_adjoint.place.x;
    pose_adjoint.place.x = f64();
    let _e40 = pose_adjoint.weight;
    pose_adjoint.weight = (_e40 + _e36);
    let _e43 = pose_adjoint;
    pose_adjoint = Pose();
    let _e47 = moved_backward(_e43, record_8.member_5_);
    let _e55 = pose_adjoint.place;
    pose_adjoint.place = (_e55 + _e47.member_0_.place);
    let _e58 = pose_adjoint.weight;
    pose_adjoint.weight = (_e58 + _e47.member_0_.weight);
    let _e61 = pose_adjoint;
    pose_adjoint = Pose();
    return Adjoints_5_(vec4<f64>(_e61.place.x, _e61.place.y, _e61.place.z, _e61.weight), vec4<f64>((_e12.x + _e47.member_1_), (_e12.y + _e20.member_1_), _e12.z, f64()));
}

fn a_struct_back(u_6: vec4<f64>, v_6: vec4<f64>, n_6: u32, adjoint_u_1: ptr<function, vec4<f64>>, adjoint_v_1: ptr<function, vec4<f64>>, adjoint_6: f64) {
    var record_9: Record_6_;

    let _e7 = a_struct_forward(u_6, v_6, n_6, (&record_9));
    let _e8 = record_9;
    let _e9 = a_struct_backward(adjoint_6, _e8);
    let _e11 = (*adjoint_u_1);
    (*adjoint_u_1) = (_e11 + _e9.member_0_);
    let _e14 = (*adjoint_v_1);
    (*adjoint_v_1) = (_e14 + _e9.member_1_);
}

fn scaled_by_forward(y_4: ptr<function, vec3<f64>>, by_3: f64, record_10: ptr<function, Record_8_>) -> f64 {
    (*record_10).member_0_ = by_3;
    let before_1 = (*y_4).x;
    let _e4 = (*y_4);
    (*record_10).member_1_ = _e4;
    (*y_4) = (_e4 * by_3);
    return (before_1 + by_3);
}

fn scaled_by_backward(y_adjoint_1: ptr<function, vec3<f64>>, adjoint_7: f64, record_11: Record_8_) -> Adjoints_7_ {
    let _e2 = (*y_adjoint_1);
    (*y_adjoint_1) = vec3<f64>();
    let _e11 = (*y_adjoint_1);
    (*y_adjoint_1) = (_e11 + (_e2 * record_11.member_0_));
    let _e14 = (*y_adjoint_1).x;
    (*y_adjoint_1).x = (_e14 + adjoint_7);
    return Adjoints_7_((adjoint_7 + dot(_e2, record_11.member_1_)));
}

fn behind_a_pointer_forward(u_7: vec4<f64>, v_7: vec4<f64>, n_7: u32, record_12: ptr<function, Record_10_>) -> f64 {
    var y_5: vec3<f64>;
    var record_13: Record_8_;
    var record_14: Record_8_;

    y_5 = u_7.xyz;
    let _e6 = scaled_by_forward((&y_5), v_7.x, (&record_13));
    let _e19 = record_13;
    (*record_12).member_7_ = _e19;
    (*record_12).member_3_ = _e6;
    let _e7 = y_5;
    let _e8 = v_7.xyz;
    let _e9 = dot(_e7, _e8);
    (*record_12).member_6_ = _e7;
    (*record_12).member_5_ = _e8;
    (*record_12).member_4_ = _e9;
    let _e12 = scaled_by_forward((&y_5), u_7.w, (&record_14));
    let _e26 = record_14;
    (*record_12).member_2_ = _e26;
    (*record_12).member_1_ = _e12;
    let _e14 = y_5.z;
    (*record_12).member_0_ = _e14;
    return ((_e9 * _e6) + (_e12 * _e14));
}

fn behind_a_pointer_backward(adjoint_8: f64, record_15: Record_10_) -> Adjoints_9_ {
    var y_adjoint_2: vec3<f64>;

    let _e9 = y_adjoint_2.z;
    y_adjoint_2.z = (_e9 + (adjoint_8 * record_15.member_1_));
    let _e14 = scaled_by_backward((&y_adjoint_2), (adjoint_8 * record_15.member_0_), record_15.member_2_);
    let _e20 = (adjoint_8 * record_15.member_3_);
    let _e27 = (_e20 * record_15.member_6_);
    let _e32 = y_adjoint_2;
    y_adjoint_2 = (_e32 + (_e20 * record_15.member_5_));
    let _e37 = scaled_by_backward((&y_adjoint_2), (adjoint_8 * record_15.member_4_), record_15.member_7_);
    let _e41 = y_adjoint_2;
    y_adjoint_2 = vec3<f64>();
    return Adjoints_9_(vec4<f64>(_e41.x, _e41.y, _e41.z, _e14.member_0_), vec4<f64>((_e27.x + _e37.member_0_), _e27.y, _e27.z, f64()));
}

fn behind_a_pointer_back(u_8: vec4<f64>, v_8: vec4<f64>, n_8: u32, adjoint_u_2: ptr<function, vec4<f64>>, adjoint_v_2: ptr<function, vec4<f64>>, adjoint_9: f64) {
    var record_16: Record_10_;

    let _e7 = behind_a_pointer_forward(u_8, v_8, n_8, (&record_16));
    let _e8 = record_16;
    let _e9 = behind_a_pointer_backward(adjoint_9, _e8);
    let _e11 = (*adjoint_u_2);
    (*adjoint_u_2) = (_e11 + _e9.member_0_);
    let _e14 = (*adjoint_v_2);
    (*adjoint_v_2) = (_e14 + _e9.member_1_);
}

