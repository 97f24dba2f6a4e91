// Rows for the host: rays of a ray database, and events of recorded paths.

const EVENT_RECORDED: u32 = 0u;
const EVENT_BIRTH: u32 = 1u;
const EVENT_SURFACE: u32 = 2u;
const EVENT_DETECTOR: u32 = 3u;
const EVENT_DEATH: u32 = 4u;

struct Event {
    kind: u32,
    // The number of the source, surface, detector or fate.
    subject: u32,
    index: u32,
    bounce: u32,
    wavelength: u32,
    weight: real,
    position_x: real,
    position_y: real,
    position_z: real,
    direction_x: real,
    direction_y: real,
    direction_z: real,
}

@group(GROUP_SCENE) @binding(BINDING_EVENTS) var<storage, read_write> events: array<Event>;

// The host cuts its ranges so that the events of one pass always fit. The test keeps a defect from writing elsewhere,
// and the count shows the defect to the host.
fn append_event(ray: Ray, kind: u32, subject: u32) {
    let slot = atomicAdd(&queue_counts.events, 1u);
    if slot < arrayLength(&events) {
        events[slot] = Event(
            kind, subject, ray.index, ray.bounce, ray.wavelength, ray.weight,
            ray.position.x, ray.position.y, ray.position.z, ray.direction.x, ray.direction.y, ray.direction.z,
        );
    }
}
