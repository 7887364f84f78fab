//! The stages of RealNet wired together: frames in, commands out.
