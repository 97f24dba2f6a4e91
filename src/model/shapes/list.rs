//! What makes two enums of the list of shapes.

/// Makes the enum `Shape` of a list of `Name(file::Type) by Function = WGSL, ...;`, and the enum `ShapeKind` of all
/// functions, whose codes in the shaders are their positions.
macro_rules! shapes {
    ($(
        $(#[doc = $doc:literal])+
        $(#[cfg($cfg:meta)])?
        $name:ident($file:ident::$type:ident) by $($(#[cfg($kind_cfg:meta)])? $kind:ident = $wgsl:ident),+;
    )+) => {
        /// A shape by its kind; what it can do stands in [`Geometry`].
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub enum Shape {
            $($(#[doc = $doc])+ $(#[cfg($cfg)])? $name($file::$type),)+
        }

        impl std::ops::Deref for Shape {
            type Target = dyn Geometry;

            fn deref(&self) -> &Self::Target {
                match self {
                    $($(#[cfg($cfg)])? Shape::$name(shape) => shape,)+
                }
            }
        }

        /// The functions of the shaders that draw shapes. A shape may have several, of which it picks one.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum ShapeKind {
            $($(
                $(#[cfg($kind_cfg)])?
                #[doc = concat!("[`", stringify!($file), "::", stringify!($wgsl), "`]")]
                $kind,
            )+)+
        }

        impl ShapeKind {
            /// What the shaders have of it.
            pub fn wgsl(self) -> &'static ShapeWgsl {
                match self {
                    $($($(#[cfg($kind_cfg)])? ShapeKind::$kind => &$file::$wgsl,)+)+
                }
            }
        }
    };
}
pub(super) use shapes;
