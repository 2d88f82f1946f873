#!/bin/sh
# Makes the videos here with ffmpeg: 12 frames of 64 x 48 px; frame t has the grey level 20 + 15 t,
# its upper left quarter 240.
set -e
cd "$(dirname "$0")"
ff() { ffmpeg -y -loglevel error "$@"; }

source="nullsrc=s=64x48:r=25,geq=lum='if(lt(X,16)*lt(Y,24),240,20+15*N)',format=gray"
ff -f lavfi -i "$source" -frames:v 12 -c:v libx264 -bf 2 -g 6 -qp 10 -pix_fmt yuv420p steady.mp4
# from the 5th frame on, without encoding it again: an edit list leaves out what is before
ff -ss 0.16 -i steady.mp4 -c copy cut.mp4
# without frames 4, 5, 6: the others keep their times
ff -i steady.mp4 -vf "select='not(between(n,4,6))'" -fps_mode passthrough -c:v libx264 -qp 10 uneven.mp4
ff -i uneven.mp4 -fps_mode passthrough -c:v mjpeg -q:v 2 uneven.mkv
ff -i steady.mp4 -c:v mpeg2video -flags +ilme+ildct -q:v 2 interlaced.mpg
ff -i steady.mp4 -vf setfield=tff -c:v prores_ks -profile:v 0 -flags +ildct interlaced.mov
# 12 bits in 16, as PNG
ff -f lavfi -i "nullsrc=s=64x48:r=25,format=gray16le,geq=lum='16*if(lt(X,16)*lt(Y,24),240,20+15*N)'" \
	-frames:v 12 -c:v png -pix_fmt gray16be grey12.mov
ff -i steady.mp4 -c:v libx264 -x264-params tff=1 -flags +ildct+ilme -qp 10 -pix_fmt yuv420p interlaced.mp4
# pixels twice as wide as high
ff -i steady.mp4 -vf setsar=2 -c:v libx264 -bf 2 -g 6 -qp 10 -pix_fmt yuv420p wide.mp4
