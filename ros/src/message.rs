//! The ROS 2 messages that are used here, each a struct with the fields of its definition.
//!
//! The macro `messages!` declares a struct once: its fields in the order of the definition, which
//! is the order in CDR. [`definition`] makes the text of its `.msg` file, with those of the
//! messages in it, in the form that recordings contain (`ros2msg`). A test compares fields and
//! layout with another implementation (`tests/interop/test_ros.py`).

use serde::de::{Error as _, SeqAccess, Visitor};
use serde::ser::SerializeTuple as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// What stands behind a type in a message.
pub trait Field {
    /// Its name in a definition, such as `float64[36]`.
    fn name() -> String;

    /// Adds the definitions of the messages in it to a list, unless they are there.
    fn collect(definitions: &mut Vec<(&'static str, String)>);
}

/// A message of its own.
pub trait Message: Field {
    /// Its type, such as `nav_msgs/msg/Odometry`.
    const TYPE: &'static str;
}

macro_rules! primitives {
    ($($rust:ty = $name:literal),*) => {$(
        impl Field for $rust {
            fn name() -> String {
                $name.into()
            }

            fn collect(_: &mut Vec<(&'static str, String)>) {}
        }
    )*};
}
primitives!(
    bool = "bool",
    u8 = "uint8",
    i32 = "int32",
    u32 = "uint32",
    f32 = "float32",
    f64 = "float64",
    String = "string"
);

impl<T: Field> Field for Vec<T> {
    fn name() -> String {
        format!("{}[]", T::name())
    }

    fn collect(definitions: &mut Vec<(&'static str, String)>) {
        T::collect(definitions);
    }
}

macro_rules! messages {
    ($($(#[$doc:meta])* $package:literal $name:ident {
        $($(#[$of:meta])* $field:ident: $kind:ty,)*
    })*) => {$(
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        pub struct $name {
            $($(#[$of])* pub $field: $kind,)*
        }

        impl Field for $name {
            fn name() -> String {
                concat!($package, "/", stringify!($name)).into()
            }

            fn collect(definitions: &mut Vec<(&'static str, String)>) {
                let name = concat!($package, "/", stringify!($name));
                if definitions.iter().any(|(known, _)| *known == name) {
                    return;
                }
                let mut text = String::new();
                $(text += &format!("{} {}\n", <$kind>::name(), stringify!($field));)*
                definitions.push((name, text));
                $(<$kind>::collect(definitions);)*
            }
        }

        impl Message for $name {
            const TYPE: &'static str = concat!($package, "/msg/", stringify!($name));
        }
    )*};
}

/// 36 numbers: a 6 by 6 matrix, row by row. serde has arrays of up to 32.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Matrix6(pub [f64; 36]);

impl Default for Matrix6 {
    fn default() -> Self {
        Self([0.0; 36])
    }
}

impl Field for Matrix6 {
    fn name() -> String {
        "float64[36]".into()
    }

    fn collect(_: &mut Vec<(&'static str, String)>) {}
}

impl Serialize for Matrix6 {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(36)?;
        for value in self.0 {
            tuple.serialize_element(&value)?;
        }
        tuple.end()
    }
}

impl<'de> Deserialize<'de> for Matrix6 {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Numbers;
        impl<'de> Visitor<'de> for Numbers {
            type Value = Matrix6;

            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("36 numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut numbers: A) -> Result<Matrix6, A::Error> {
                let mut matrix = Matrix6::default();
                for (index, value) in matrix.0.iter_mut().enumerate() {
                    *value = numbers
                        .next_element()?
                        .ok_or_else(|| A::Error::invalid_length(index, &self))?;
                }
                Ok(matrix)
            }
        }
        deserializer.deserialize_tuple(36, Numbers)
    }
}

messages! {
    /// A moment; 0 s and 0 ns stands for "not said".
    "builtin_interfaces" Time {
        /// s since 1970.
        sec: i32,
        /// ns.
        nanosec: u32,
    }
    /// When, and in which frame.
    "std_msgs" Header {
        /// When.
        stamp: Time,
        /// In which frame.
        frame_id: String,
    }
    /// A truth value.
    "std_msgs" Bool {
        /// The value.
        data: bool,
    }
    /// Three numbers along the axes.
    "geometry_msgs" Vector3 {
        /// Forward.
        x: f64,
        /// Left.
        y: f64,
        /// Up.
        z: f64,
    }
    /// A place, m.
    "geometry_msgs" Point {
        /// Forward.
        x: f64,
        /// Left.
        y: f64,
        /// Up.
        z: f64,
    }
    /// A rotation.
    "geometry_msgs" Quaternion {
        /// i.
        x: f64,
        /// j.
        y: f64,
        /// k.
        z: f64,
        /// Real part.
        w: f64,
    }
    /// A velocity, m/s and rad/s.
    "geometry_msgs" Twist {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    }
    /// A velocity, when and in which frame.
    "geometry_msgs" TwistStamped {
        /// When and in which frame.
        header: Header,
        /// The velocity.
        twist: Twist,
    }
    /// Place and rotation.
    "geometry_msgs" Pose {
        /// m.
        position: Point,
        /// Rotation.
        orientation: Quaternion,
    }
    /// A pose and how well it is known.
    "geometry_msgs" PoseWithCovariance {
        /// The pose.
        pose: Pose,
        /// x, y, z, rotations about x, y, z.
        covariance: Matrix6,
    }
    /// A velocity and how well it is known.
    "geometry_msgs" TwistWithCovariance {
        /// The velocity.
        twist: Twist,
        /// x, y, z, rotations about x, y, z.
        covariance: Matrix6,
    }
    /// From one frame to another.
    "geometry_msgs" Transform {
        /// m.
        translation: Vector3,
        /// Rotation.
        rotation: Quaternion,
    }
    /// A frame in its parent.
    "geometry_msgs" TransformStamped {
        /// When, and the parent.
        header: Header,
        /// The child.
        child_frame_id: String,
        /// The child in its parent.
        transform: Transform,
    }
    /// Frames in their parents.
    "tf2_msgs" TFMessage {
        /// One each.
        transforms: Vec<TransformStamped>,
    }
    /// Pose in the odometry's frame, velocity in the robot's.
    "nav_msgs" Odometry {
        /// When, and the frame of the pose.
        header: Header,
        /// The frame of the velocity.
        child_frame_id: String,
        /// Pose.
        pose: PoseWithCovariance,
        /// Velocity.
        twist: TwistWithCovariance,
    }
    /// Joints by name.
    "sensor_msgs" JointState {
        /// When.
        header: Header,
        /// Names.
        name: Vec<String>,
        /// rad.
        position: Vec<f64>,
        /// rad/s.
        velocity: Vec<f64>,
        /// N m; empty where it is not known.
        effort: Vec<f64>,
    }
    /// A battery; NaN where it is not known.
    "sensor_msgs" BatteryState {
        /// When, and which robot.
        header: Header,
        /// V.
        voltage: f32,
        /// degrees Celsius.
        temperature: f32,
        /// A.
        current: f32,
        /// A h.
        charge: f32,
        /// A h.
        capacity: f32,
        /// A h.
        design_capacity: f32,
        /// 0 to 1.
        percentage: f32,
        /// 0 for not known.
        power_supply_status: u8,
        /// 0 for not known.
        power_supply_health: u8,
        /// 0 for not known.
        power_supply_technology: u8,
        /// Whether there is one.
        present: bool,
        /// V, of each cell.
        cell_voltage: Vec<f32>,
        /// degrees Celsius, of each cell.
        cell_temperature: Vec<f32>,
        /// Where it is.
        location: String,
        /// Its number.
        serial_number: String,
    }
    /// One value of a status.
    "diagnostic_msgs" KeyValue {
        /// What.
        key: String,
        /// How much.
        value: String,
    }
    /// The state of one thing.
    "diagnostic_msgs" DiagnosticStatus {
        /// One of [`DiagnosticLevel`].
        level: DiagnosticLevel,
        /// Of what.
        name: String,
        /// In words.
        message: String,
        /// Which one.
        hardware_id: String,
        /// Its values.
        values: Vec<KeyValue>,
    }
    /// The state of all.
    "diagnostic_msgs" DiagnosticArray {
        /// When.
        header: Header,
        /// One each.
        status: Vec<DiagnosticStatus>,
    }
}

/// How bad it is: OK 0, WARN 1, ERROR 2, STALE 3. A byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum DiagnosticLevel {
    /// As it should be.
    #[default]
    Ok,
    /// It goes on, but not as asked.
    Warn,
    /// It does not go on.
    Error,
    /// Nothing is known.
    Stale,
}

impl Field for DiagnosticLevel {
    fn name() -> String {
        "byte".into()
    }

    fn collect(_: &mut Vec<(&'static str, String)>) {}
}

impl Serialize for DiagnosticLevel {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u8(*self as u8)
    }
}

impl<'de> Deserialize<'de> for DiagnosticLevel {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match u8::deserialize(deserializer)? {
            0 => Ok(Self::Ok),
            1 => Ok(Self::Warn),
            2 => Ok(Self::Error),
            3 => Ok(Self::Stale),
            other => Err(D::Error::custom(format_args!("{other} is no level"))),
        }
    }
}

impl Time {
    /// So many ns since 1970.
    #[must_use]
    pub fn of_ns(ns: u64) -> Self {
        Self {
            sec: i32::try_from(ns / 1_000_000_000).unwrap_or(i32::MAX),
            nanosec: u32::try_from(ns % 1_000_000_000).unwrap_or(0),
        }
    }

    /// ns since 1970.
    #[must_use]
    pub fn ns(&self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }

    /// Whether no moment is said.
    #[must_use]
    pub const fn is_unset(&self) -> bool {
        self.sec == 0 && self.nanosec == 0
    }
}

impl Quaternion {
    /// A turn about the vertical axis, counter-clockwise, rad.
    #[must_use]
    pub fn of_heading(heading: f64) -> Self {
        let (z, w) = (heading / 2.0).sin_cos();
        Self {
            z,
            w,
            ..Self::default()
        }
    }
}

/// The definition of a message and of those in it, as one text.
#[must_use]
pub fn definition<M: Message>() -> String {
    let mut all = Vec::new();
    M::collect(&mut all);
    let mut text = String::new();
    for (index, (name, fields)) in all.iter().enumerate() {
        if index > 0 {
            text += &format!("{}\nMSG: {name}\n", "=".repeat(80));
        }
        text += fields;
    }
    text
}

/// A message in little-endian CDR, with the four bytes that say so.
///
/// # Errors
/// When a sequence or a text has 4 GB.
pub fn to_cdr<M: Message + Serialize>(message: &M) -> Result<Vec<u8>, cdr_encoding::Error> {
    let mut bytes = vec![0, 1, 0, 0];
    cdr_encoding::to_writer::<M, byteorder::LittleEndian, _>(&mut bytes, message)?;
    Ok(bytes)
}
