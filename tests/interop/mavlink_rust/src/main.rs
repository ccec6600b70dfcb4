//! decode FILE: a JSON object a message, by the crate `mavlink`. request TS1: a TIMESYNC request.

use mavlink::dialects::common::{MavMessage, TIMESYNC_DATA};
use mavlink::{MavHeader, MavlinkVersion};
use serde_json::{json, Value};

fn fields(message: &MavMessage) -> Value {
    match message {
        MavMessage::ODOMETRY(m) => json!({
            "name": "ODOMETRY", "time_usec": m.time_usec,
            "frame_id": m.frame_id as u32, "child_frame_id": m.child_frame_id as u32,
            "x": m.x, "y": m.y, "z": m.z, "q": m.q.to_vec(),
            "vx": m.vx, "vy": m.vy, "vz": m.vz,
            "rollspeed": m.rollspeed, "pitchspeed": m.pitchspeed, "yawspeed": m.yawspeed,
            "pose_covariance": m.pose_covariance.to_vec(),
            "velocity_covariance": m.velocity_covariance.to_vec(),
            "reset_counter": m.reset_counter, "estimator_type": m.estimator_type as u32,
            "quality": m.quality,
        }),
        MavMessage::HEARTBEAT(m) => json!({
            "name": "HEARTBEAT", "type": m.mavtype as u32, "autopilot": m.autopilot as u32,
            "base_mode": m.base_mode.bits(), "custom_mode": m.custom_mode,
            "system_status": m.system_status as u32, "mavlink_version": m.mavlink_version,
        }),
        MavMessage::STATUSTEXT(m) => json!({
            "name": "STATUSTEXT", "severity": m.severity as u32,
            "text": m.text.to_str().expect("not UTF-8"), "id": m.id, "chunk_seq": m.chunk_seq,
        }),
        MavMessage::TIMESYNC(m) => json!({
            "name": "TIMESYNC", "tc1": m.tc1, "ts1": m.ts1,
            "target_system": m.target_system, "target_component": m.target_component,
        }),
        other => json!({ "name": format!("{other:?}") }),
    }
}

fn decode(path: &str) {
    let file = std::fs::File::open(path).expect("cannot be opened");
    let mut reader = mavlink::MavlinkReader::new(file);
    while let Ok((header, message)) = reader.read_message::<MavMessage>(MavlinkVersion::V2) {
        let mut line = fields(&message);
        line["sender"] = json!([header.system_id, header.component_id]);
        line["sequence"] = json!(header.sequence);
        println!("{line}");
    }
}

fn request(ts1: &str) {
    let header = MavHeader { system_id: 1, component_id: 1, sequence: 7 };
    let asked = TIMESYNC_DATA {
        tc1: 0,
        ts1: ts1.parse().expect("not a number"),
        target_system: 1,
        target_component: 197,
    };
    let message = MavMessage::TIMESYNC(asked);
    mavlink::write_v2_msg(&mut std::io::stdout(), header, &message).expect("cannot be written");
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    match arguments[1].as_str() {
        "decode" => decode(&arguments[2]),
        _ => request(&arguments[2]),
    }
}
